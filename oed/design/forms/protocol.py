"""What a criterion is: the logarithm of an information function phi of M.

An information function (Pukelsheim 2006, chapter 5) is positively homogeneous,
phi(a M) = a phi(M), and, except for the condition number, concave. Two consequences
carry all design methods:

* Efficiencies are comparable: phi(M) / phi(M*) is the share of readings that the best
  plan would need.
* A concave phi lies below each of its supporting lines, which pass through the origin.
  With a support (v, R) at M,

      log phi(M') <= v + log <R R^T, M'>      for every M' >= 0,

  so a bound over all plans is one sum over the candidates' gradient |X_i R|^2
  (`oed.design.objective`).
"""

import abc
from typing import Any, NamedTuple

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import parts, project_on_estimable
from oed.design.pairs import Pairs
from oed.linear_algebra import symmetric_inverse

SHORTLIST_PAIRS = 8  #: number of exchanges whose values are computed one by one


class Support(NamedTuple):
    """A supporting line: log phi(M') <= value + log <root root^T, M'>; root (n, r)."""

    value: float
    root: Array


class Criterion(abc.ABC):
    """A criterion over n directions.

    Everywhere M (n, n) is symmetric and blocks (C, k, n) are whitened, scaled rows. What
    is not stated here holds of a smooth, concave criterion without methods of its own.
    """

    name: str  #: as in the catalogue

    # -- properties --------------------------------------------------------------------
    @property
    def concave(self) -> bool:
        """Whether `support` exists, and with it relaxations and bounds by convexity."""
        return True

    @property
    def smooth(self) -> bool:
        """Whether Newton steps apply; if not, `continuation` leads there."""
        return True

    @property
    def spectral(self) -> bool:
        """Whether a column that no reading touches counts, as one more eigenvalue."""
        return False

    @property
    def any_coordinates(self) -> bool:
        """Whether coordinates that are not orthonormal only shift log phi."""
        return False

    @property
    def starts_from_own_plan(self) -> bool:
        """Whether a greedy plan by the criterion begins a search, beside one by D."""
        return True

    @property
    def ceiling(self) -> float:
        """log phi that no information exceeds, whatever the candidates."""
        return np.inf

    @property
    def log_size(self) -> int:
        """Factor of log phi in the logarithm that users know: directions, for log det."""
        return 1

    # -- values ------------------------------------------------------------------------
    @abc.abstractmethod
    def value(self, m: Array) -> float:
        """log phi(M); -inf where M leaves a direction undetermined that phi needs."""

    @abc.abstractmethod
    def conventional_value(self, value: float, readings: int) -> float:
        """The criterion from log phi, as tables state it; variances negative."""

    def support(self, m: Array) -> Support:
        """Supporting line at M, positive definite.

        Where the criterion is smooth, root root^T is the gradient of log phi. Raises
        ValueError where there is no line.
        """
        raise ValueError(f"{self.name} has no supporting line")

    def curvature(self, m: Array, blocks: Array) -> Array:
        """-d2 log phi / dw_i dw_j (C, C). Raises ValueError if not smooth."""
        raise ValueError(f"{self.name} is not smooth: follow its continuation")

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """log phi(M + X_i^T X_i) (C,); -inf for candidates outside a shortlist."""
        return np.array([self.value(m + block.T @ block) for block in blocks])

    def gradient_matrix(self, m: Array) -> Array:
        """S (n, n) with d log phi = tr(S dM) at M, or near it where phi is smoothed."""
        root = self.support(m).root
        return np.asarray(root @ root.T)

    def exchange_values(self, pairs: Pairs) -> Array:
        """An increasing function (N, C) of log phi after each exchange; -inf off a shortlist.

        The shortlist holds the exchanges by which the mean variance with the criterion's
        gradient falls most.
        """
        weighted = self.gradient_matrix(pairs.m)
        falls = pairs.reductions(symmetric_inverse(pairs.m), weighted).ravel()
        size = min(SHORTLIST_PAIRS, len(falls))
        values = np.full(len(falls), -np.inf)
        for pair in np.argpartition(-falls, size - 1)[:size]:
            values[pair] = self.value(pairs.information_after(int(pair)))
        return values.reshape(len(pairs.chosen), len(pairs.blocks))

    # -- other criteria that follow from it --------------------------------------------
    @abc.abstractmethod
    def restrict(self, basis: Array) -> "Criterion":
        """The same criterion of B^T M B, for an orthonormal basis B (n, r)."""

    def profile_others(self, columns: Index, total: int) -> "Criterion":
        """The criterion of some of `total` columns. Raises ValueError."""
        raise ValueError(f"{self.name} does not profile out other columns")

    def continuation(self) -> "tuple[Criterion, ...]":
        """Criteria that approach this one, the smoothest first and itself last."""
        return (self,)

    def restrict_to_rows(self, rows: Array) -> "tuple[Criterion, Array]":
        """The criterion over the directions (n, r) that rows (N, n) determine, and these."""
        basis = project_on_estimable(rows[:, None], None)[1]
        return self.restrict(basis), basis

    @property
    def guides(self) -> "tuple[Criterion, ...]":
        """Criteria that lead a search to this one, the smoothest first."""
        return self.continuation()

    @property
    def relaxed(self) -> "Criterion":
        """The criterion, or the last one of its continuation that has a relaxation."""
        steps = (*self.continuation(), self)
        return [step for step in steps if step.concave and step.smooth][-1]

    # -- methods of its own ------------------------------------------------------------
    @property
    def polished(self) -> "Criterion | None":
        """The criterion with an `expression` to polish poses by; None without one."""
        return None

    def expression(self, m: Any) -> Any:
        """`log_size` log phi of a CasADi SX matrix (n, n), up to a constant."""
        raise NotImplementedError


def pairwise_traces(blocks: Array, first: Array, second: Array) -> Array:
    """tr(A_i P A_j Q) (C, C), A_i = X_i^T X_i, P, Q symmetric, no zero rows."""
    count, k, _ = blocks.shape
    is_row = np.asarray(blocks.any(axis=2))
    is_row[:, 0] = True  # each block has a row where its sum begins
    rows = blocks[is_row]
    by_first = rows @ first @ rows.T
    by_second = by_first if second is first else rows @ second @ rows.T
    product = by_first * by_second
    if len(rows) == count:
        return product
    if is_row.all():
        return np.asarray(product.reshape(count, k, count, k).sum(axis=(1, 3)))
    counts = is_row.sum(axis=1)
    return _sum_rows(_sum_rows(product, counts).T, counts)


def _sum_rows(table: Array, counts: Index) -> Array:
    """Sums (C, r) of the first counts[0] rows of a table (R, r), the next, and so on."""
    starts = np.cumsum(counts) - counts
    sums = table[starts]
    for position in range(1, int(counts.max())):
        longer = np.flatnonzero(counts > position)
        sums[longer] += table[starts[longer] + position]
    return np.asarray(sums)


def inner_products(blocks: Array, matrix: Array) -> Array:
    """X_i P X_i^T (C, k, k) for a symmetric P `matrix` (n, n)."""
    return (blocks @ matrix) @ np.swapaxes(blocks, 1, 2)


def weight_gradient(blocks: Array, root: Array) -> Array:
    """|X_i R|^2 (C,): gradient of log phi along the weights."""
    count, k, n = blocks.shape
    norms = np.empty(count)
    for part in parts(count):
        projected = blocks[part].reshape(-1, n) @ root
        row_norms = np.einsum("ij,ij->i", projected, projected)
        norms[part] = row_norms.reshape(-1, k).sum(axis=1)
    return norms


def quadratic_forms(rows: Array, matrix: Array) -> Array:
    """x_i^T P x_i (C,) of rows (C, n)."""
    forms = np.empty(len(rows))
    for part in parts(len(rows)):
        forms[part] = np.einsum("ij,ij->i", rows[part] @ matrix, rows[part])
    return forms


def is_positive_definite(m: Array) -> bool:
    """Whether M is positive definite beyond rounding, whatever its columns' units."""
    scale = np.sqrt(np.maximum(np.diag(m), 0.0))
    if not scale.all() or not np.isfinite(scale).all():
        return False
    least = np.linalg.eigvalsh(m / np.outer(scale, scale))[0]
    return bool(least > 4 * len(m) * np.finfo(float).eps)
