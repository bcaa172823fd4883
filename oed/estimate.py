"""The result of an identification: parameters, covariance, residuals and noise."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.coordinates import IdentifiableCoordinates
from oed.noise.covariance import Noise

#: posterior over prior standard deviation above which a parameter is weakly identified,
#: and above which it stays at its prior
WEAK, AT_PRIOR = 0.3, 0.7


@dataclasses.dataclass(frozen=True)
class FitStage:
    """One stage of an identification.

    patterns    of the names of the parameters that it frees
    iterations  evaluations of the model
    rms_before  root mean square of the whitened residuals where it starts
    rms_after   the same where it ends
    """

    patterns: tuple[str, ...]
    iterations: int
    rms_before: float
    rms_after: float


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Identified parameters.

    theta             (n,) maximum a posteriori, SI
    covariance        (n, n) posterior (Laplace), SI; directions that no reading
                      determines keep their prior variance
    prior_sd          (n,) tolerances of the last stage, SI
    coordinates       identifiable coordinates of the last stage
    z                 (r,) the solution in them
    residuals         (N,) y - f(theta), SI
    residuals_before  (N,) the same at the start
    noise             noise used, SI; scaled where its scale was estimated
    noise_scale       {set-up: factor on the stated noise}
    noise_estimated   whether these factors were estimated
    dof               readings less effectively determined directions
    chi2              sum of squared whitened residuals
    stages            the stages of the fit
    warnings          sentences that a user must read
    """

    theta: Array
    covariance: Array
    prior_sd: Array
    coordinates: IdentifiableCoordinates
    z: Array
    residuals: Array
    residuals_before: Array
    noise: Noise
    noise_scale: dict[str, float]
    noise_estimated: bool
    dof: float
    chi2: float
    stages: tuple[FitStage, ...]
    warnings: tuple[str, ...]

    @property
    def sd(self) -> Array:
        """Posterior standard deviations (n,), SI."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shrinkage(self) -> Array:
        """Posterior over prior standard deviation (n,); 0 for held parameters.

        1 means that the readings carry no information.
        """
        free = self.prior_sd > 0
        ratio = np.zeros_like(self.sd)
        return np.divide(self.sd, self.prior_sd, out=ratio, where=free)
