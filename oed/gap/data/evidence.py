"""Evidence in closed form. With Gram matrix A = G^T M G and b = G^T M r, coefficients
N(0, t^2) in units of the noise,

    2 log p(r | G, t) - 2 log p(r | no gap) = -log |1 + t^2 A| - (N + 2a) log(1 - gain /
    (2b0 + r^T M r)), gain = b^T (1 / t^2 + A)^-1 b,

where the noise's level s has been integrated out: s^2 is inverse gamma (a, b0), and all
prior variances go with it. Columns selected before are taken out by the Schur
complement, so that each step of a search is of this form again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg, special

from oed.arrays import Array, Index
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw, Whitener

#: sizes of effects against their physical prior scales, equally likely: the scales are
#: of a good machine tool, and a printer's errors are ten times as large
SIZES = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0])
#: energy of a direction of columns, at their prior scales, that is far below the noise
#: at the largest size too
UNSEEN = 1e-4
#: inverse gamma prior of the squared noise level: its stated value to within a factor
#: of about two
SHAPE, RATE = 2.0, 2.0


@dataclasses.dataclass(frozen=True)
class Grams:
    """Gram matrix (K, K), projections b (K,), and what the residual has left; `size`
    readings.

    log_det of Sigma + H Lambda H^T;  rest: r^T M r;  base: log evidence of no further
                                      column
    """

    gram: Array
    b: Array
    rest: float
    size: int
    base: float

    def part(self, columns: Index) -> Grams:
        """Grams of some columns alone."""
        return dataclasses.replace(
            self, gram=self.gram[np.ix_(columns, columns)], b=self.b[columns]
        )

    def given(self, columns: Index, size: float) -> Grams:
        """With `columns` selected, their coefficients N(0, size^2)."""
        if not len(columns):
            return self
        inner = self.gram[np.ix_(columns, columns)] + np.eye(len(columns)) / size**2
        factor = linalg.cholesky(inner, lower=True)
        half = linalg.solve_triangular(factor, self.gram[columns], lower=True)
        told = linalg.solve_triangular(factor, self.b[columns], lower=True)
        gain = float(told @ told)
        log_det = 2.0 * float(np.log(np.diag(factor)).sum()) + 2.0 * len(
            columns
        ) * np.log(size)
        return Grams(
            gram=self.gram - half.T @ half,
            b=self.b - half.T @ told,
            rest=self.rest - gain,
            size=self.size,
            base=self.base + self.log_ratio(np.array(gain), np.array(log_det)).item(),
        )

    def without(self, columns: Index) -> Grams:
        """With what `columns` could explain taken out of all others, as for
        coefficients without a prior.
        """
        if not len(columns):
            return self
        root = inverse_root(self.gram[np.ix_(columns, columns)])
        half = root.T @ self.gram[columns]
        told = root.T @ self.b[columns]
        return dataclasses.replace(
            self, gram=self.gram - half.T @ half, b=self.b - half.T @ told
        )

    def log_ratio(self, gain: Array, log_det: Array) -> Array:
        """Log evidence of columns that explain `gain` of the rest, over that of none."""
        left = np.maximum(1.0 - gain / (2.0 * RATE + self.rest), 1e-300)
        return np.asarray(-0.5 * log_det - (0.5 * self.size + SHAPE) * np.log(left))

    def log_evidences(self, choices: Sequence[Index], sizes: Array = SIZES) -> Array:
        """Log evidence (atoms, sizes) of each choice of columns at each prior size,
        over no further column.
        """
        found = np.zeros((len(choices), len(sizes)))
        for at, rows in by_count(choices):
            found[at] = self.log_ratio(
                *explained(
                    self.gram[rows[:, :, None], rows[:, None, :]], self.b[rows], sizes
                )
            )
        return found


def inverse_root(gram: Array) -> Array:
    """R (k, m) with R R^T the pseudo-inverse of a Gram matrix (k, k), without
    directions that no size makes visible.
    """
    values, vectors = np.linalg.eigh(gram)
    kept = values > max(1e-9 * float(values.max(initial=0.0)), UNSEEN)
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]))


def by_count(choices: Sequence[Index]) -> list[tuple[Index, Index]]:
    """Choices of columns, those with as many together: their numbers (a,) and their
    columns (a, d).
    """
    counts = np.array([len(c) for c in choices], dtype=int)
    groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
    return [(at, np.array([choices[int(k)] for k in at])) for at in groups]


def explained(gram: Array, b: Array, sizes: Array) -> tuple[Array, Array]:
    """What columns of Gram matrices (a, d, d) and projections b (a, d) explain at each
    prior size, and log determinants: (a, sizes) each.
    """
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    told = np.einsum("akj,ak->aj", vectors, b) ** 2
    wide = 1.0 + values[:, None, :] * sizes[None, :, None] ** 2
    return (told[:, None, :] * sizes[None, :, None] ** 2 / wide).sum(axis=2), np.log(
        wide
    ).sum(axis=2)


def carried(gram: Array, b: Array, sizes: Array | float) -> float:
    """Energy b^T C A C b, C = (A + 1 / sizes^2)^-1, of what columns are found to
    explain, beyond what they would of mere noise: the trace of C A.
    """
    spread = np.linalg.inv(gram + np.eye(len(b)) / np.square(sizes))
    mean = spread @ b
    return max(float(mean @ gram @ mean) - float(np.trace(spread @ gram)), 0.0)


class Parts:
    """Columns (N, K) in a metric, of which some at a time are wanted as Grams."""

    def __init__(self, problem: GapProblem, metric: Metric, columns: Array) -> None:
        self._columns = metric.parts(columns)
        self._residual = metric.parts(problem.residual[:, None])
        self._size = metric.size
        self._rest = float(
            sum(
                s * (r**2).sum()
                for s, r in zip((1.0, -1.0), self._residual, strict=True)
            )
        )
        self._base = _student(metric.log_det, self._rest, metric.size)

    def grams(self, some: slice = slice(None)) -> Grams:
        """Of some columns; `base` is the log evidence of no gap, of the readings in
        units of their noise.
        """
        white, absorbed = (part[:, some] for part in self._columns)
        gram = white.T @ white - absorbed.T @ absorbed
        b = white.T @ self._residual[0] - absorbed.T @ self._residual[1]
        return Grams(gram, b[:, 0], self._rest, self._size, self._base)


def grams(problem: GapProblem, metric: Metric, columns: Array) -> Grams:
    """Of columns (N, K) in a metric; `base` is the log evidence of no gap, of the
    readings in units of their noise.
    """
    return Parts(problem, metric, columns).grams()


def _student(log_det: float, rest: float, size: int) -> float:
    """Log density of readings with r^T C^-1 r = rest, their level integrated out."""
    half = 0.5 * size + SHAPE
    return float(
        -0.5 * log_det
        - half * np.log(RATE + 0.5 * rest)
        + special.gammaln(half)
        - special.gammaln(SHAPE)
        + SHAPE * np.log(RATE)
        - 0.5 * size * np.log(2.0 * np.pi)
    )


def compressed(problem: GapProblem, columns: Array) -> Array:
    """Columns (N, k') with the same covariance as [H Lambda^1/2, columns], without what
    is far below the noise.
    """
    both = np.hstack([problem.slopes, columns])
    left, values, _ = np.linalg.svd(both, full_matrices=False)
    kept = values > 0.03
    return np.asarray(left[:, kept] * values[kept])


def log_evidence(problem: GapProblem, law: NoiseLaw, columns: Array) -> float:
    """Log evidence of the readings, the law's level integrated out: r ~ N(0, s^2 (Sigma
    + columns columns^T)).

    `columns` (N, k) hold the parameters' slopes too, as from `compressed`.
    """
    whitener = Whitener(problem, law)
    white = whitener.white(np.column_stack([problem.residual, columns]))
    full = white.T @ white
    factor = linalg.cholesky(
        full[1:, 1:] + np.eye(columns.shape[1]), lower=True, check_finite=False
    )
    told = linalg.solve_triangular(factor, full[1:, 0], lower=True, check_finite=False)
    log_det = whitener.log_det + 2.0 * float(np.log(np.diag(factor)).sum())
    return _student(log_det, float(full[0, 0] - told @ told), whitener.size)


def level(found: Grams) -> float:
    """Noise level where what is left has been explained: the mode of s."""
    return float(np.sqrt((RATE + 0.5 * found.rest) / (0.5 * found.size + SHAPE)))
