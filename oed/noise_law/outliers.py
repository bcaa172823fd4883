"""Readings far off: heavy tails, detected from what each reading is predicted to be from
all others.

An error e of density f, with score s(e) = -f'(e) / f(e) and Fisher information I = E
s^2, tells of a small change what a normal error of s(e) / I and variance 1 / I tells:
the log densities agree to second order. With its own error replaced so, a reading is
one of normal noise; no explanation has outliers of its own, and all compare as they do
where tails are light (pseudo-values of an M-estimator, Huber 1964).

So that a fit with normal noise is not bent, residuals that their neighbours and the
prior contradict are replaced by such pseudo-values. What is replaced is judged against
the widest residual that the tolerances allow, so that no error of the machine is taken
for an outlier.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import scipy

from oed.base import Array
from oed.noise import NOTHING_STATED, Laws, NoiseLaw, NoiseStatement, ReadingStructure
from oed.noise_law.prior import scale_over_stated

#: degrees of freedom of the Student t that are tried
STUDENT_DOF = (3.0, 4.0, 6.0, 10.0)
OUTLIER_SHARES = (0.005, 0.01, 0.02, 0.05)  #: shares of outliers that are tried
#: sizes of outliers that are tried, over the noise of the others
OUTLIER_SCALES = (5.0, 10.0)
#: sizes of single readings that have nothing to do with the others: a probe that touched
#: nothing, a typing error
GROSS_SCALES = (30.0, 100.0)
#: log likelihood over that of normal errors, from which on tails are heavy
MIN_LOG_RATIO = 3.0
#: iterations of residuals and what they are predicted to be without outliers
MAX_ITERATIONS = 12
STEP_TOLERANCE = 1e-3  #: change of a residual, over the stated noise, at which they end
MIN_READINGS = 8  #: fewest readings among which one can be recognised as far off
#: errors over which the information is integrated
_GRID = np.linspace(-60.0, 60.0, 12001)


@dataclasses.dataclass(frozen=True)
class StudentT:
    """Student t of some degrees of freedom."""

    dof: float
    outlier_share = 0.0

    def log_density(self, e: Array) -> Array:
        """Of errors in units of the scale."""
        n = self.dof
        norm = (
            scipy.special.gammaln(0.5 * (n + 1.0))
            - scipy.special.gammaln(0.5 * n)
            - 0.5 * np.log(n * np.pi)
        )
        return np.asarray(norm - 0.5 * (n + 1.0) * np.log1p(e**2 / n))

    def weight(self, e: Array) -> Array:
        """s(e) / e."""
        return (self.dof + 1.0) / (self.dof + e**2)


@dataclasses.dataclass(frozen=True)
class ContaminatedNormal:
    """Normal errors, a share of which is `outlier_scale` times as large."""

    outlier_share: float
    outlier_scale: float
    dof = np.inf

    def _parts(self, e: Array) -> tuple[Array, Array]:
        core = np.log1p(-self.outlier_share) - 0.5 * e**2
        return core, np.log(self.outlier_share / self.outlier_scale) - 0.5 * (
            e / self.outlier_scale
        ) ** 2

    def log_density(self, e: Array) -> Array:
        """Of errors in units of the core's."""
        return np.asarray(np.logaddexp(*self._parts(e)) - 0.5 * np.log(2.0 * np.pi))

    def weight(self, e: Array) -> Array:
        """s(e) / e."""
        core, far = self._parts(e)
        ordinary = scipy.special.expit(core - far)
        return np.asarray(ordinary + (1.0 - ordinary) / self.outlier_scale**2)


ErrorDensity = StudentT | ContaminatedNormal
NORMAL = ContaminatedNormal(1e-12, 1.0)
CANDIDATE_DENSITIES: tuple[ErrorDensity, ...] = (
    *(StudentT(dof) for dof in STUDENT_DOF),
    *(
        ContaminatedNormal(share, scale)
        for share, scale in itertools.product(OUTLIER_SHARES, OUTLIER_SCALES)
    ),
)
#: the same, with single gross errors
ROBUST_DENSITIES = (
    *CANDIDATE_DENSITIES,
    *(
        ContaminatedNormal(share, scale)
        for share, scale in itertools.product(OUTLIER_SHARES, GROSS_SCALES)
    ),
)


def stated_densities(statement: NoiseStatement) -> tuple[ErrorDensity, ...] | None:
    """The densities that are stated: () for no tails, None where nothing is stated."""
    if statement.student_dof is not None:
        return (StudentT(statement.student_dof),)
    share = statement.outlier_share
    if share is None:
        return None
    if share == 0.0:
        return ()
    scales = (*OUTLIER_SCALES, *GROSS_SCALES)
    return tuple(ContaminatedNormal(share, scale) for scale in scales)


@functools.cache
def fisher_information(shape: ErrorDensity) -> float:
    """Fisher information of an error, over that of a normal one of the same unit."""
    score = shape.weight(_GRID) * _GRID
    return float(np.trapezoid(score**2 * np.exp(shape.log_density(_GRID)), _GRID))


@dataclasses.dataclass(frozen=True)
class Outliers:
    """Readings far off, and residuals that replace theirs."""

    #: (N,) of normal noise with the same information, in units of the stated noise
    pseudo_residual: Array
    density: ErrorDensity  #: of the errors
    #: log likelihood of these over that of the residuals as normal ones
    log_odds: float
    #: whether the last iteration changed no residual by a tolerance
    has_converged: bool

    def with_outliers(self, law: NoiseLaw) -> NoiseLaw:
        """The law of `residual`, with how many of the readings are far off."""
        return dataclasses.replace(
            law, student_dof=self.density.dof, outlier_share=self.density.outlier_share
        )


class Covariance(Protocol):
    """A covariance C of N readings by its inverse: noise, or the root of a covariance."""

    def precision(self, values: Array) -> Array:
        """C^-1 Y (N, m), for Y (N, m)."""

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of C^-1."""


def detect_outliers(
    residual: Array,
    covariance: Covariance,
    densities: Sequence[ErrorDensity] = CANDIDATE_DENSITIES,
    statement: NoiseStatement = NOTHING_STATED,
) -> Outliers | None:
    """Outliers of residuals (N,) whose covariance is wide enough for any gap; None
    where tails are light, by `densities` or stated ones.

    By e_i = (C^-1 r)_i / (C^-1)_ii, the error of predicting a reading from all others.
    """
    stated = stated_densities(statement)
    least = MIN_LOG_RATIO if stated is None else -np.inf
    densities = densities if stated is None else stated
    if not densities:
        return None
    clean = residual
    diagonal = covariance.precision_diagonal()
    root = np.sqrt(diagonal)
    for iteration in range(MAX_ITERATIONS):
        predicted = clean - covariance.precision(clean[:, None])[:, 0] / diagonal
        errors = (residual - predicted) * root
        fits = [(shape, *_fitted(shape, errors)) for shape in (NORMAL, *densities)]
        shape, scale, height = max(fits[1:], key=lambda fit: fit[2])
        if height < fits[0][2] + least:
            return None
        e = errors / scale
        normal = shape.weight(e) * e / fisher_information(shape)
        step = predicted + normal * scale / root - clean
        clean = clean + (step if iteration == 0 else 0.5 * step)
        if np.abs(step).max() < STEP_TOLERANCE:
            break
    information = fisher_information(shape)
    odds = (
        shape.log_density(e)
        - NORMAL.log_density(normal * np.sqrt(information))
        - 0.5 * np.log(information)
    )
    return Outliers(
        pseudo_residual=clean,
        density=shape,
        log_odds=float(odds.sum()) - np.log(len(densities)),
        has_converged=bool(np.abs(step).max() < STEP_TOLERANCE),
    )


def _fitted(shape: ErrorDensity, errors: Array) -> tuple[float, float]:
    """The scale of errors that suits a shape best, and their log likelihood."""

    def cost(log_scale: float) -> float:
        return float(
            len(errors) * log_scale
            - shape.log_density(errors * np.exp(-log_scale)).sum()
        )

    middle = np.log(np.median(np.abs(errors)) + 1e-12)
    minimum = scipy.optimize.minimize_scalar(
        cost, bounds=(middle - 2.0, middle + 2.0), method="bounded"
    )
    return float(np.exp(minimum.x)), -float(minimum.fun)


def robust_residuals(
    structure: ReadingStructure, laws: Laws, residual: Array, slopes: Array
) -> Array:
    """Residuals (N,) about the prior's middle, with those far off replaced.

    slopes  (N, r) over z ~ N(0, I), which hold what the machine may do
    """
    if len(residual) < MIN_READINGS:
        return residual.copy()
    if structure.has_effects:
        slopes = np.hstack([slopes, structure.effects])
    covariance = laws.factor(structure).widened(slopes)
    result = detect_outliers(
        residual, covariance, ROBUST_DENSITIES, structure.statement
    )
    return residual.copy() if result is None else result.pseudo_residual


#: normal coordinates of the noise's scale over which it is integrated
_SCALE_COORDINATES = np.linspace(-3.0, 8.0, 23)


def densities_over_scales(x: Array, freedoms: Sequence[float]) -> tuple[Array, Array]:
    """Log densities (T, K, n) of errors (n,) for tails and scales; log prior (T, K).

    freedoms  (T,) degrees of freedom of Student t; infinite of normal errors
    """
    tails = [NORMAL if np.isinf(dof) else StudentT(dof) for dof in freedoms]
    scale = scale_over_stated(_SCALE_COORDINATES)
    prior = -0.5 * _SCALE_COORDINATES**2
    prior -= scipy.special.logsumexp(prior) + np.log(len(tails))
    scaled = x / scale[:, None]
    densities = [tail.log_density(scaled) for tail in tails]
    by_tail = np.array(densities) - np.log(scale)[:, None]
    return by_tail, np.tile(prior, (len(tails), 1))
