"""A, c and I: a mean of variances, t = tr(W M^-1), phi = 1 / t.

W = F^T F: the identity for A; one row c for c; for I the mean of J^T J over workspace
poses, J (k, n) the slopes of the pose components that matter (home-referenced, absolute
or best-fit, see `oed.predict`). With S = M^-1 W M^-1 / t,

    d log phi / dw_i = tr(S A_i) = g_i,      -d2 log phi / dw_i dw_j = 2 tr(A_i M^-1 A_j
                                             S) - g_i g_j.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design.criterion.protocol import (
    Criterion,
    Support,
    inverse,
    pairs,
    positive,
    products,
    slopes,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Variance:
    """Minus a mean of variances, of the rows of `factor` F (r, n): W = F^T F. told:
    -tr(W M^-1).
    """

    factor: Array
    name: str = "I"
    concave: bool = True
    smooth: bool = True

    def value(self, m: Array) -> float:
        """-log tr(W M^-1)."""
        return (
            -float(np.log(np.sum((self.factor @ inverse(m)) * self.factor)))
            if positive(m)
            else -np.inf
        )

    def support(self, m: Array) -> Support:
        """Root M^-1 F^T / sqrt(t)."""
        half = np.linalg.inv(np.linalg.cholesky(m))
        moved = half @ self.factor.T
        t = float(np.sum(moved * moved))
        return Support(-float(np.log(t)), half.T @ moved / np.sqrt(t))

    def curvature(self, m: Array, blocks: Array) -> Array:
        """2 tr(A_i M^-1 A_j S) - g_i g_j."""
        root = self.support(m).root
        g = slopes(blocks, root)
        return np.asarray(
            2.0 * pairs(blocks, inverse(m), root @ root.T) - np.outer(g, g)
        )

    def added(self, m: Array, blocks: Array) -> Array:
        """t less tr((1 + X M^-1 X^T)^-1 X M^-1 W M^-1 X^T)."""
        inverted = inverse(m)
        moved = inverted @ self.factor.T
        t = float(np.sum(moved * self.factor.T))
        return np.asarray(
            -np.log(np.maximum(t - saved(blocks, inverted, moved @ moved.T), 1e-300))
        )

    def told(self, value: float, readings: int) -> float:
        """-tr(W M^-1)."""
        return -float(np.exp(-value))

    def within(self, basis: Array) -> Criterion:
        """The variances of what the basis sees of each row."""
        factor = self.factor @ basis
        if self.name == "c" and np.linalg.norm(factor) < (1 - 1e-8) * np.linalg.norm(
            self.factor
        ):
            raise ValueError(
                "no reading sees the combination c: choose another, or give more"
                " candidates"
            )
        return dataclasses.replace(self, factor=factor)

    def ladder(self) -> tuple[Criterion, ...]:
        """Itself."""
        return (self,)


def saved(blocks: Array, inverted: Array, moved: Array) -> Array:
    """tr((1 + X P X^T)^-1 X T X^T) (C,) for P `inverted` and T `moved` (n, n)."""
    inner = products(blocks, moved)
    own = products(blocks, inverted)
    if blocks.shape[1] == 1:
        return np.asarray(inner[:, 0, 0] / (1.0 + own[:, 0, 0]))
    eye = np.eye(blocks.shape[1])
    return np.asarray(np.trace(np.linalg.solve(own + eye, inner), axis1=1, axis2=2))
