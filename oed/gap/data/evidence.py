"""Log evidence of columns with Gaussian coefficients, in closed form.

With Gram matrix A = G^T M G and b = G^T M r, coefficients N(0, t^2) in units of the
noise,

    2 log p(r | G, t) - 2 log p(r | no gap) =
        -log |1 + t^2 A| - (N + 2a) log(1 - gain / (2 b0 + r^T M r)),
    gain = b^T (1 / t^2 + A)^-1 b.

The noise level s is integrated out: s^2 is inverse gamma (a, b0), and all prior
variances scale with it. The Schur complement takes out columns selected before, so that
each step of a search is of this form again.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy import linalg, special

from oed.arrays import Array, Index
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.root import inverse_root
from oed.noise.law import NoiseLaw

#: sizes of effects against their physical prior scales, equally likely: the scales are
#: of a good machine tool, and a printer's errors are ten times as large
SIZES = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0])
#: energy of a direction of columns, at their prior scales, that is far below the noise
#: at the largest size too
UNSEEN = 1e-4
#: size of a direction of columns, in units of the noise, below which `compress` drops it
FAINT = 0.03
#: inverse gamma prior of the squared noise level: its stated value to within a factor
#: of about two
SHAPE, RATE = 2.0, 2.0


@dataclasses.dataclass(frozen=True)
class Grams:
    """Inner products of K columns and of the residual, in a metric.

    gram     (K, K) Gram matrix of the columns
    b        (K,) projections of the residual on the columns
    energy   r^T M r of the residual
    size     number of readings
    base     log evidence of no further column
    """

    gram: Array
    b: Array
    energy: float
    size: int
    base: float

    def subset(self, columns: Index) -> Grams:
        """Grams of some columns alone."""
        gram = self.gram[np.ix_(columns, columns)]
        return dataclasses.replace(self, gram=gram, b=self.b[columns])

    def select(self, columns: Index, size: float) -> Grams:
        """Grams with `columns` in the model, their coefficients N(0, size^2)."""
        if not len(columns):
            return self
        precision = np.eye(len(columns)) / size**2
        inner = self.gram[np.ix_(columns, columns)] + precision
        factor = linalg.cholesky(inner, lower=True)
        half = linalg.solve_triangular(factor, self.gram[columns], lower=True)
        projected = linalg.solve_triangular(factor, self.b[columns], lower=True)
        gain = float(projected @ projected)
        log_sizes = 2.0 * len(columns) * np.log(size)
        log_det = 2.0 * float(np.log(np.diag(factor)).sum()) + log_sizes
        ratio = self.log_ratio(np.array(gain), np.array(log_det)).item()
        return Grams(
            gram=self.gram - half.T @ half,
            b=self.b - half.T @ projected,
            energy=self.energy - gain,
            size=self.size,
            base=self.base + ratio,
        )

    def project_out(self, columns: Index) -> Grams:
        """Grams without what `columns` can explain, their coefficients unbounded."""
        if not len(columns):
            return self
        root = visible_root(self.gram[np.ix_(columns, columns)])
        half = root.T @ self.gram[columns]
        projected = root.T @ self.b[columns]
        gram = self.gram - half.T @ half
        return dataclasses.replace(self, gram=gram, b=self.b - half.T @ projected)

    def log_ratio(self, gain: Array, log_det: Array) -> Array:
        """Log evidence of columns that explain `gain` of the energy, over no column."""
        share = np.maximum(1.0 - gain / (2.0 * RATE + self.energy), 1e-300)
        power = 0.5 * self.size + SHAPE
        return np.asarray(-0.5 * log_det - power * np.log(share))

    def log_evidences(
        self,
        choices: Sequence[Index],
        sizes: Array = SIZES,
    ) -> Array:
        """Log evidence (choices, sizes) of each choice of columns, over no column."""
        table = np.zeros((len(choices), len(sizes)))
        for numbers, rows in group_by_count(choices):
            grams = self.gram[rows[:, :, None], rows[:, None, :]]
            gain, log_det = explained_energy(grams, self.b[rows], sizes)
            table[numbers] = self.log_ratio(gain, log_det)
        return table


def visible_root(gram: Array) -> Array:
    """R (k, m) with R R^T the pseudo-inverse of a Gram matrix (k, k).

    Directions that no size makes visible are left out.
    """
    return inverse_root(gram, lambda largest: max(1e-9 * largest, UNSEEN))


def group_by_count(choices: Sequence[Index]) -> list[tuple[Index, Index]]:
    """Choices of columns grouped by their number of columns.

    Each group has the numbers (a,) of its choices and their columns (a, d).
    """
    counts = np.array([len(choice) for choice in choices], dtype=int)
    groups = []
    for count in np.unique(counts):
        numbers = np.flatnonzero(counts == count)
        groups.append((numbers, np.array([choices[int(k)] for k in numbers])))
    return groups


def explained_energy(
    gram: Array,
    b: Array,
    sizes: Array,
) -> tuple[Array, Array]:
    """Energy that columns explain at each prior size, and log determinants.

    For Gram matrices (a, d, d) and projections b (a, d), both results are (a, sizes).
    """
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    energy = np.einsum("akj,ak->aj", vectors, b) ** 2
    variance = sizes[None, :, None] ** 2
    inflation = 1.0 + values[:, None, :] * variance
    gain = (energy[:, None, :] * variance / inflation).sum(axis=2)
    return gain, np.log(inflation).sum(axis=2)


class WhitenedColumns:
    """Columns (N, K) in a metric, of which some at a time are wanted as Grams."""

    def __init__(self, problem: GapProblem, metric: Metric, columns: Array) -> None:
        self._columns = metric.parts(columns)
        residual = metric.parts(problem.residual[:, None])
        self.size = metric.size
        white, absorbed = residual
        self.energy = float((white**2).sum() - (absorbed**2).sum())
        self.base = _log_student(metric.log_det, self.energy, metric.size)
        #: (K,) projections of the residual
        self.b = _product(self._columns, residual)[:, 0]

    @functools.cached_property
    def diagonal(self) -> Array:
        """Energy (K,) of each column."""
        white, absorbed = self._columns
        energy = np.einsum("nk,nk->k", white, white)
        return np.asarray(energy - np.einsum("nk,nk->k", absorbed, absorbed))

    def of(self, columns: slice | Index) -> WhitenedColumns:
        """Some of the columns alone."""
        some = copy.copy(self)
        some._columns = self._parts(columns)
        some.b = self.b[columns]
        some.__dict__.pop("diagonal", None)
        return some

    def grams(self, columns: slice | Index = slice(None)) -> Grams:
        """Grams of some columns; `base` is the log evidence of no gap."""
        parts = self._parts(columns)
        return Grams(
            gram=_product(parts, parts),
            b=self.b[columns],
            energy=self.energy,
            size=self.size,
            base=self.base,
        )

    def with_others(self, others: WhitenedColumns) -> Array:
        """Inner products (K, L) with other columns."""
        return _product(self._columns, others._columns)

    def blocks(self, choices: Index) -> Array:
        """Gram matrices (a, d, d) of choices (a, d) of columns."""
        every = [self._parts(choice) for choice in choices]
        return np.array([_product(parts, parts) for parts in every])

    def _parts(self, columns: slice | Index) -> tuple[Array, Array]:
        white, absorbed = self._columns
        return white[:, columns], absorbed[:, columns]


def _product(a: tuple[Array, Array], b: tuple[Array, Array]) -> Array:
    """Inner products (k, l) of values (N, k) and (N, l), in their parts."""
    return np.asarray(a[0].T @ b[0] - a[1].T @ b[1])


def grams(problem: GapProblem, metric: Metric, columns: Array) -> Grams:
    """Grams of columns (N, K) in a metric; `base` is the log evidence of no gap."""
    return WhitenedColumns(problem, metric, columns).grams()


def _log_student(log_det: float, energy: float, size: int) -> float:
    """Log density of readings with r^T C^-1 r = energy, their level integrated out."""
    half = 0.5 * size + SHAPE
    return float(
        -0.5 * log_det
        - half * np.log(RATE + 0.5 * energy)
        + special.gammaln(half)
        - special.gammaln(SHAPE)
        + SHAPE * np.log(RATE)
        - 0.5 * size * np.log(2.0 * np.pi)
    )


def compress(problem: GapProblem, columns: Array) -> Array:
    """Columns (N, k') with the same covariance as [H Lambda^1/2, columns].

    Directions far below the noise are left out.
    """
    both = np.hstack([problem.slopes, columns])
    directions, sizes, _ = np.linalg.svd(both, full_matrices=False)
    visible = sizes > FAINT
    return np.asarray(directions[:, visible] * sizes[visible])


def log_evidence(problem: GapProblem, law: NoiseLaw, columns: Array) -> float:
    """Log evidence of the readings under a law, its level integrated out.

    The readings are r ~ N(0, s^2 (Sigma + columns columns^T)). `columns` (N, k) hold
    the parameters' slopes too, as from `compress`.
    """
    noise = law.factor(problem)
    white = noise.whiten(np.column_stack([problem.residual, columns]))
    return log_evidence_of_products(white.T @ white, noise.log_det, len(problem))


def log_evidence_of_products(products: Array, log_det: float, size: int) -> float:
    """The same of the whitened products (1 + k, 1 + k) of residual and columns.

    log_det  log determinant of Sigma
    """
    inner = products[1:, 1:] + np.eye(len(products) - 1)
    factor = linalg.cholesky(inner, lower=True, check_finite=False)
    projected = linalg.solve_triangular(
        factor, products[1:, 0], lower=True, check_finite=False
    )
    log_factor = float(np.log(np.diag(factor)).sum())
    energy = float(products[0, 0] - projected @ projected)
    return _log_student(log_det + 2.0 * log_factor, energy, size)


def noise_level(grams: Grams) -> float:
    """Noise level of what is not explained: the mode of s."""
    energy = RATE + 0.5 * grams.energy
    return float(np.sqrt(energy / (0.5 * grams.size + SHAPE)))
