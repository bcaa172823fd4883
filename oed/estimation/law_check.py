"""Whether a noise law explains readings as noise: Hausman's test of its weights.

Readings about nominal, in units of the stated noise, are r = H z + e, with z ~ N(0, 1) and
e of the law's covariance C. Without what the law carries along and levels of runs it is D.
Two estimates of z are unbiased if the law is true:

    by the law        G H^T C^-1 r,      G = (1 + H^T C^-1 H)^-1,
    by D alone        A^-1 H^T D^-1 r,   A = 1 + H^T D^-1 H,

and their difference d has the covariance V = S - G (Hausman 1978, Econometrica 46:1251),
S = A^-1 (1 + H^T D^-1 C D^-1 H) A^-1. What the model lacks is no noise: the law then favours
channels that parameters can be bent to, and differences of neighbouring readings, and d is
too large. Tested is the sum of squares that the law's estimate adds, d^T H^T D^-1 H d.

Where it is too large, or the law carries along more than a stated noise can be wrong by,
readings have their stated weights, as in least squares. Noise and tolerances are the stated
ones, T, times a factor w that makes the variances of the estimate what they are under the
law, on average over its r directions (Pauli, Racugno and Ventura 2011):

    w^2 = tr[(H^T T^-1 H)^-1 H^T T^-1 C T^-1 H] / r.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.noise.factor import Errors, LinearFactor
from oed.noise.law_noise import errors_of, factor_of
from oed.noise.prior import KNOWN_TO
from oed.noise.process import Laws, stated_laws
from oed.noise.structure import ReadingStructure

#: probability of a larger difference below which the law's weights are not used: the
#: usual level of a test, as a wrong law costs far more than plain weights
CONTRADICTED = 0.05
#: error that is carried along, over the stated noise, from which it is none of the
#: instrument's: two standard deviations of what a statement is good for
NO_NOISE = KNOWN_TO**2
#: share of a variance that is rounding
ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class LawCheck:
    """How far the estimate by a law is from the one by its variances alone.

    ratio        of the sum of squares between them to what the law lets expect
    probability  of a larger one if what the law describes is noise
    widening     w: sd of an estimate by stated weights under the law, over the stated one
    carried      standard deviation of what readings have in common with their neighbours,
                 over the stated noise; 0 where that is an assumption
    """

    ratio: float
    probability: float
    widening: float
    carried: float = 0.0

    @property
    def is_noise(self) -> bool:
        """Whether neighbouring readings have no more in common than noise can."""
        return self.carried <= NO_NOISE

    @property
    def is_contradicted(self) -> bool:
        """Whether the readings speak against the law's weights."""
        return self.probability < CONTRADICTED or not self.is_noise


def check_law(
    structure: ReadingStructure, law: Laws, residual: Array, slopes: Array
) -> LawCheck:
    """The test for standardised readings about nominal.

    law       the first of them is tested
    residual  (N,) readings less those of nominal parameters
    slopes    (N, r) over z
    """
    errors = errors_of(structure, law)
    one = np.eye(slopes.shape[1])
    weighted = factor_of(structure, _uncorrelated(law)).precision(slopes)
    information = slopes.T @ weighted
    by_variances = np.linalg.inv(one + information)
    between = one + errors.covariance_of(weighted)
    white = factor_of(structure, law).whiten(np.column_stack([residual, slopes]))
    gram = white[:, 1:].T @ white
    by_law = np.linalg.inv(one + gram[:, 1:])
    difference = by_variances @ (weighted.T @ residual) - by_law @ gram[:, 0]
    expected = information @ (by_variances @ between @ by_variances - by_law)
    total = float(difference @ information @ difference)
    ratio, probability = _of_sum(total, expected)
    stated = factor_of(structure, stated_laws(structure))
    widening = _widening(slopes, stated, errors)
    return LawCheck(ratio, probability, widening, _carried(structure, law))


def _carried(structure: ReadingStructure, law: Laws) -> float:
    """What the first law carries along, of the group in which it is largest."""
    if structure.statement.is_assumed:
        return 0.0
    return float(law.scale[0].max() * np.sqrt(law.carried[0]))


def _uncorrelated(law: Laws) -> Laws:
    """A law of the same variances, with nothing carried along and no level of runs."""
    none = np.zeros(len(law))
    scale = law.scale * np.sqrt(1.0 + law.level**2)[:, None]
    return dataclasses.replace(law, scale=scale, carried=none, level=none)


def _widening(slopes: Array, stated: LinearFactor, errors: Errors) -> float:
    """w, over the directions that slopes (N, r) determine."""
    weighted = stated.precision(slopes)
    values, vectors = np.linalg.eigh(slopes.T @ weighted)
    determined = values > ROUNDING * values.max(initial=0.0)
    if not determined.any():
        return 1.0
    root = vectors[:, determined] / np.sqrt(values[determined])
    variances = np.diag(errors.covariance_of(weighted @ root))
    return float(np.sqrt(np.mean(variances)))


def _of_sum(total: float, expected: Array) -> tuple[float, float]:
    """Ratio to its mean, and probability of more, of a weighted sum of squares.

    Its first two moments are those of a scaled chi-square (Satterthwaite 1946).
    """
    mean = float(np.trace(expected))
    spread = 2.0 * float(np.trace(expected @ expected))
    if mean <= ROUNDING * len(expected) or spread <= 0.0:
        return 0.0, 1.0
    dof = 2.0 * mean**2 / spread
    ratio = total / mean
    return ratio, float(special.chdtrc(dof, ratio * dof))
