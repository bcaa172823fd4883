"""Goodness of fit against the stated noise, with a probability in both tails."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from scipy import special

from oed.arrays import Array
from oed.checks.fit import Fit, residual_weights
from oed.estimate import Estimate
from oed.measurement import Measurement, Series

#: probability of a tail below which residuals are too large or too small
ALARM = 1e-5


@dataclasses.dataclass(frozen=True)
class Goodness:
    """How residuals compare with the stated noise.

    chi2    sum of squared whitened residuals
    dof     its expectation: values less effectively determined directions
    p_low   probability of a smaller sum
    p_high  probability of a larger sum
    """

    chi2: float
    dof: float
    p_low: float
    p_high: float

    @property
    def ratio(self) -> float:
        """Residuals over the stated noise."""
        return float((self.chi2 / self.dof) ** 0.5) if self.dof > 0.0 else 1.0

    @property
    def too_large(self) -> bool:
        """Whether the stated noise does not explain the residuals."""
        return self.p_high < ALARM

    @property
    def too_small(self) -> bool:
        """Whether the stated noise would leave larger residuals."""
        return self.p_low < ALARM


def goodness(solution: Fit) -> Goodness:
    """Goodness of a fit, by a scaled chi-squared law of the right mean and variance.

    The weights of chi2 are 1 / (1 + s^2) for singular values s of the slopes, and 1
    (Satterthwaite, Biometrics Bulletin 2 (1946) 110-114).
    """
    return goodness_of(solution.chi2, solution.weights())


def goodness_of_estimate(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> Goodness:
    """Goodness of an estimate's fit against the noise that the set-ups state."""
    jacobian = measurement.jacobian(series, estimate.theta)
    slopes = measurement.in_prior_units(jacobian, estimate.prior_sd > 0.0)
    white = measurement.noise(series).whiten(slopes)
    return goodness_of(estimate.chi2, residual_weights(white))


def goodness_of(chi2: float, weights: Array) -> Goodness:
    """Goodness of a sum of squares chi2 of terms with these weights (N,)."""
    total, squares = float(weights.sum()), float(weights @ weights)
    if total <= 0.0:
        return Goodness(chi2, 0.0, 1.0, 1.0)
    scale, freedom = squares / total, total**2 / squares
    scaled = chi2 / scale
    p_low = float(special.chdtr(freedom, scaled))
    p_high = float(special.chdtrc(freedom, scaled))
    return Goodness(chi2, total, p_low, p_high)
