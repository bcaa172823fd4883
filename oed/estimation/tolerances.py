"""Tolerances that readings contradict: a common factor on all, by its evidence.

To first order the whitened readings are r = H z + e, with z ~ N(0, s^2 I) in tolerances
and e ~ N(0, w^2 I) in the stated noise. With H = U D V^T and a = U^T r, of r dimensions,

    -2 log p(r | s, w) = sum_k [ log(w^2 + s^2 d_k^2) + a_k^2 / (w^2 + s^2 d_k^2) ]
                         + (N - r) log w^2 + (|r|^2 - |a|^2) / w^2.

Tolerances of a drawing may be too small by a decade, all of them alike where a unit or a class
of fit is wrong: they then hold the parameters at nominal, and what that leaves looks like
noise, or like an effect. s = 1 is given up where it is improbable, and where another s leaves
no more than noise can. Where few combinations of parameters are far from nominal and the
others are not, nominal numbers are wrong and no tolerances: each is then of s = 1 with the
probability 0.8. Tolerances that are too large are left: they cost little, and smaller
ones would make what no reading determines too sure.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.estimation.estimate import Estimate
from oed.estimation.law_check import NO_NOISE
from oed.measurement import Measurement, Series
from oed.model.parameter import Parameter

#: factors on the tolerances: four a decade, up to thirty times
FACTORS = 10.0 ** (np.arange(7) / 4.0)
#: prior probability that the tolerances are as stated, and that below which they are not
AS_STATED, IMPROBABLE = 0.95, 0.05
#: share of the combinations that are far where few nominal numbers are wrong
FEW = 0.2
#: noise over the stated one: 20 a decade; scale of the log of what a statement is good for,
#: with the tails of a Cauchy density
LEVELS, LEVEL_SCALE = 10.0 ** (np.arange(-20, 81) / 20.0), 0.4


@dataclasses.dataclass(frozen=True)
class ToleranceFactor:
    """What readings say of all tolerances together.

    factor       the most probable one, of `FACTORS`
    probability  that they are as stated, but for few parameters
    level        noise over the stated one with that factor
    """

    factor: float
    probability: float
    level: float

    @property
    def is_sure(self) -> bool:
        """Whether tolerances as stated are improbable, and larger ones explain it."""
        return self.probability < IMPROBABLE and self.level <= NO_NOISE


def tolerance_factor(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> ToleranceFactor:
    """The factor by readings linear about an estimate, under the stated noise."""
    noise = measurement.noise(series)
    free = estimate.prior_sd > 0.0
    jacobian = measurement.jacobian(series, estimate.theta)
    slopes = noise.whiten(measurement.in_prior_units(jacobian, free))
    change = np.where(free, estimate.theta - measurement.nominal, 0.0)
    residual = noise.whiten(estimate.residuals + jacobian @ change)
    return _most_probable(slopes, residual)


def with_tolerances(measurement: Measurement, factor: float) -> Measurement:
    """The measurement with all tolerances times a factor."""

    def scaled(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
        return tuple(
            dataclasses.replace(p, tolerance=factor * p.tolerance) for p in parameters
        )

    machine = measurement.machine.with_parameters(
        scaled(measurement.machine.parameters)
    )
    setups = [
        dataclasses.replace(s, nuisances=scaled(s.nuisances))
        for s in measurement.setups.values()
    ]
    kinematics = measurement.kinematics.with_priors_of(machine)
    return Measurement(machine, setups, kinematics)


def _most_probable(slopes: Array, residual: Array) -> ToleranceFactor:
    """The factor for whitened slopes (N, n) and residuals (N,) about nominal."""
    directions, singular, _ = np.linalg.svd(slopes, full_matrices=False)
    along = (directions.T @ residual) ** 2
    outside = max(float(residual @ residual - along.sum()), 0.0)
    freedom = len(residual) - len(singular)
    noise = LEVELS[None, :, None] ** 2
    variance = noise + (FACTORS[:, None] * singular)[:, None, :] ** 2
    each = -0.5 * (np.log(variance) + along / variance)
    further = -0.5 * (freedom * np.log(LEVELS**2) + outside / LEVELS**2)
    further = further - np.log1p((np.log(LEVELS) / LEVEL_SCALE) ** 2)
    all_alike = each.sum(axis=2) + further
    few = np.logaddexp(np.log(1.0 - FEW) + each[:1], np.log(FEW) + each[1:])
    few_far = few.sum(axis=2) + further
    others = np.log((1.0 - AS_STATED) / len(few))
    prior = np.full(len(FACTORS), others - np.log(2.0))
    prior[0] = np.log(AS_STATED)
    of_all = special.logsumexp(all_alike, axis=1) + prior
    of_few = special.logsumexp(few_far, axis=1) + prior[1:]
    best = int(np.argmax(of_all))
    total = special.logsumexp(np.concatenate([of_all, of_few]))
    return ToleranceFactor(
        factor=float(FACTORS[best]),
        probability=float(-np.expm1(special.logsumexp(of_all[1:]) - total)),
        level=float(LEVELS[int(np.argmax(all_alike[best]))]),
    )
