"""What a criterion is.

A criterion is the logarithm of an information function phi of M (Pukelsheim 2006,
chapter 5): positively homogeneous, phi(a M) = a phi(M), and, but for the condition
number, concave. Two consequences carry the whole design room:

* efficiencies are comparable: phi(M) / phi(M*) is the share of readings that the best
  plan would need;
* a concave phi lies below each of its supporting lines, which pass through the origin:
  with a support (v, R) at M,

      log phi(M') <= v + log <R R^T, M'>      for every M' >= 0,

  so a bound over all plans is one sum over the candidates' slopes |X_i R|^2 (see
  `oed.design.certificate`).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from oed.arrays import Array


class Support(NamedTuple):
    """A supporting line: log phi(M') <= value + log <root root^T, M'>; root is (n, r)."""

    value: float
    root: Array


class Criterion(Protocol):
    """A criterion over n directions. M (n, n) is symmetric; blocks (C, k, n) are
    whitened, scaled rows.

    name        as in the catalogue
    concave     whether `support` and `curvature` exist, and with them relaxations and
                bounds by convexity
    smooth      whether Newton steps make sense; if not, `ladder` leads there over
                smooth ones
    """

    @property
    def name(self) -> str: ...

    @property
    def concave(self) -> bool: ...

    @property
    def smooth(self) -> bool: ...

    def value(self, m: Array) -> float:
        """log phi(M); -inf where M leaves a direction unseen that the criterion asks
        for.
        """
        ...

    def support(self, m: Array) -> Support:
        """Supporting line at M, positive definite; where smooth, root root^T is the
        slope of log phi.
        """
        ...

    def curvature(self, m: Array, blocks: Array) -> Array:
        """-d2 log phi / dw_i dw_j (C, C) for M + sum w_i X_i^T X_i, positive
        semidefinite.
        """
        ...

    def added(self, m: Array, blocks: Array) -> Array:
        """log phi(M + X_i^T X_i) (C,); -inf where it was found not worth computing."""
        ...

    def told(self, value: float, readings: int) -> float:
        """The number that users know, from log phi: log det M, -trace, kappa, ..."""
        ...

    def within(self, basis: Array) -> Criterion:
        """The same criterion of B^T M B, for an orthonormal basis B (n, r) of the
        directions seen.
        """
        ...

    def ladder(self) -> tuple[Criterion, ...]:
        """Criteria that lead to this one, easier ones first; itself last."""
        ...


def pairs(blocks: Array, first: Array, second: Array) -> Array:
    """tr(A_i P A_j Q) (C, C) with A_i = X_i^T X_i, for symmetric P `first` and Q
    `second` (n, n).
    """
    count, k, n = blocks.shape
    flat = blocks.reshape(-1, n)
    left = flat @ first @ flat.T
    product = left * left if second is first else left * (flat @ second @ flat.T)
    return (
        product
        if k == 1
        else np.asarray(product.reshape(count, k, count, k).sum(axis=(1, 3)))
    )


def products(blocks: Array, matrix: Array) -> Array:
    """X_i P X_i^T (C, k, k) for symmetric P `matrix` (n, n)."""
    return np.asarray((blocks @ matrix) @ np.swapaxes(blocks, 1, 2))


def slopes(blocks: Array, root: Array) -> Array:
    """|X_i R|^2 (C,): slope of log phi along each weight."""
    count, k, n = blocks.shape
    moved = blocks.reshape(-1, n) @ root
    return np.asarray(np.einsum("ij,ij->i", moved, moved).reshape(count, k).sum(axis=1))


def inverse(m: Array) -> Array:
    """M^-1, symmetric."""
    inverted = np.linalg.inv(m)
    return np.asarray(0.5 * (inverted + inverted.T))


def positive(m: Array) -> bool:
    """Whether M is positive definite beyond rounding, whatever the units of its
    columns.
    """
    scale = np.sqrt(np.maximum(np.diag(m), 0.0))
    if not scale.all() or not np.isfinite(scale).all():
        return False
    return bool(
        np.linalg.eigvalsh(m / np.outer(scale, scale))[0]
        > 4 * len(m) * np.finfo(float).eps
    )
