"""Goodness of fit against the stated noise, with a probability in both tails."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import Array, Mask
from oed.checks.fit import Fit, residual_weights
from oed.estimation import Estimate
from oed.measurement import Measurement, Series
from oed.trust import ALARM_PROBABILITY, GUESS_RATIO, noise_ratio


@dataclasses.dataclass(frozen=True)
class Goodness:
    """How residuals compare with the stated noise.

    chi2    sum of squared whitened residuals
    dof     its expectation: values less effectively determined directions
    p_low   probability of a smaller sum
    p_high  probability of a larger sum
    law_p_low, law_p_high  the same of the sum under the law that is estimated, with a
            scatter within what a statement is good for (`oed.checks.judgement`); None
            where no law is
    """

    chi2: float
    dof: float
    p_low: float
    p_high: float
    law_p_low: float | None = None
    law_p_high: float | None = None

    @property
    def ratio(self) -> float | None:
        """Residuals over the stated noise; None where too little freedom judges it."""
        return noise_ratio(self.chi2, self.dof)

    @property
    def too_large(self) -> bool:
        """Whether neither the stated noise nor its law explains the residuals."""
        is_by_law = self.law_p_high is not None and (self.ratio or 0.0) <= GUESS_RATIO
        p_high = self.law_p_high if is_by_law else self.p_high
        return p_high is not None and p_high < ALARM_PROBABILITY

    def is_bad(self, *, noise_is_a_guess: bool) -> bool:
        """Whether neither the stated noise nor an estimated one explains the residuals."""
        explained = noise_is_a_guess and self.chi2 <= GUESS_RATIO**2 * self.dof
        return self.too_large and not explained

    @property
    def too_small(self) -> bool:
        """Whether the stated noise, or its law, would leave larger residuals."""
        return (
            self.p_low if self.law_p_low is None else self.law_p_low
        ) < ALARM_PROBABILITY


def goodness(solution: Fit) -> Goodness:
    """Goodness of a fit, by a scaled chi-squared law of the right mean and variance.

    The weights of chi2 are 1 / (1 + s^2) for singular values s of the slopes, and 1
    (Satterthwaite, Biometrics Bulletin 2 (1946) 110-114).
    """
    return goodness_of(solution.chi2, solution.weights())


def goodness_of_estimate(
    measurement: Measurement,
    series: Sequence[Series],
    estimate: Estimate,
    doubtful: Mask | None = None,
) -> Goodness:
    """Goodness of an estimate's parameters against the noise that the set-ups state.

    doubtful  (N,) values that are fitted, and that the figures leave out
    """
    noise = measurement.noise(series)
    jacobian = measurement.jacobian(series, estimate.theta)
    slopes = measurement.in_prior_units(jacobian, estimate.prior_sd > 0.0)
    if doubtful is None or not doubtful.any():
        return goodness_of(estimate.chi2, residual_weights(noise.whiten(slopes)))
    # values that are left out have no information and no misfit
    weight = np.where(doubtful, 0.0, 1.0)
    white = noise.whiten(weight * estimate.residuals)
    weights = residual_weights(noise.whiten(weight[:, None] * slopes))
    # each value left out would add a weight of 1
    count = int(doubtful.sum())
    return goodness_of(float(white @ white), np.sort(weights)[: len(weights) - count])


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
