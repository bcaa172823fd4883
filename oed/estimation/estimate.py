"""The result of an identification: parameters, covariance, residuals and noise."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oed.base import Array

if TYPE_CHECKING:
    from oed.estimation.coordinates import IdentifiableCoordinates
    from oed.estimation.discrepancy import SampledEffects
    from oed.estimation.law_stage import LawCheck
    from oed.noise import Noise
    from oed.noise_law import NoisePosterior


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
    noise             noise used, SI; of the most probable law where it was estimated
    dof               readings less effectively determined directions
    chi2              sum of squared `residuals` whitened by the stated noise. With
                      effects, of what they leave at their mean
    stages            the stages of the fit
    warnings          sentences that a user must read
    noise_posterior   of the noise law; None where the noise is as stated
    robust_readings   (N,) readings, SI, with those far off replaced; None likewise
    effects           draws of effects that the model lacks; None where none were allowed
    law_check         whether the estimated law, without a course through the session,
                      explains the readings as noise; None where its course does, or where
                      the noise is as stated, or effects are allowed. Where it does not,
                      the estimate is that of the stated weights, `widened`, without a
                      noise posterior

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> estimate.theta.shape, estimate.covariance.shape
    ((13,), (13, 13))
    >>> bool(estimate.chi2 / estimate.dof < 2.0)
    True
    """

    #: shrinkage above which a parameter is weakly identified
    WEAK: ClassVar = 0.3
    #: shrinkage above which it stays at its prior
    AT_PRIOR: ClassVar = 0.7

    theta: Array
    covariance: Array
    prior_sd: Array
    coordinates: IdentifiableCoordinates
    z: Array
    residuals: Array
    residuals_before: Array
    noise: Noise
    dof: float
    chi2: float
    stages: tuple[FitStage, ...]
    warnings: tuple[str, ...]
    noise_posterior: NoisePosterior | None = None
    robust_readings: Array | None = None
    effects: SampledEffects | None = None
    law_check: LawCheck | None = None

    @property
    def sd(self) -> Array:
        """Posterior standard deviations (n,), SI."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def contradicted(self) -> LawCheck | None:
        """The check of the noise law, where the readings contradict it."""
        check = self.law_check
        return check if check is not None and check.is_contradicted else None

    @property
    def scatter(self) -> float:
        """Scatter of readings over the stated noise, where the noise law is rejected."""
        if self.contradicted is None:
            return 1.0
        return float(np.sqrt(max(self.chi2 / max(self.dof, 1.0), 1.0)))

    @property
    def widening(self) -> float:
        """Factor on noise and tolerances in the intervals."""
        return 1.0 if self.contradicted is None else self.contradicted.widening

    def widened(self, factor: float) -> Estimate:
        """The same values, with noise and tolerances a factor as large.

        Both alike, so that doubt of the noise moves no value. Directions that no reading
        determines keep their tolerance: no residual tells of them.
        """
        null = self.coordinates.null_basis
        lost = null @ null.T
        return dataclasses.replace(
            self,
            covariance=factor**2 * (self.covariance - lost) + lost,
            coordinates=self.coordinates.widened(factor),
            z=self.z / factor,
            noise=self.noise.scaled(factor),
        )

    @property
    def shrinkage(self) -> Array:
        """Posterior over prior standard deviation (n,); 0 for held parameters.

        1 means that the readings carry no information. Where intervals are widened, with
        the tolerances, it is that of the fit before: lost directions were not widened.
        """
        lost = (self.coordinates.null_basis**2).sum(axis=1)
        variance = (self.sd**2 - lost) / self.widening**2 + lost
        sd = np.sqrt(np.maximum(variance, 0.0))
        free = self.prior_sd > 0
        ratio = np.zeros_like(self.sd)
        return np.asarray(np.divide(sd, self.prior_sd, out=ratio, where=free))
