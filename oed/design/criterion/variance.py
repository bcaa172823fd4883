"""A, c and I: a mean of variances, t = tr(W M^-1), phi = 1 / t.

W = F^T F is the identity for A and one row c for c. For I it is the mean of J^T J over
workspace poses, with J (k, n) the slopes of the pose components of interest
(home-referenced, absolute or best-fit, `oed.accuracy.prediction`). With S = M^-1 W M^-1 / t,

    d log phi / dw_i = tr(S A_i) = g_i,
    -d2 log phi / dw_i dw_j = 2 tr(A_i M^-1 A_j S) - g_i g_j.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.design.criterion.protocol import (
    Criterion,
    Support,
    inner_products,
    inverse,
    is_positive_definite,
    pairwise_traces,
    slopes,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Variance:
    """Mean of the variances of the rows of `factor` F (r, n): W = F^T F.

    Its conventional value is -tr(W M^-1).
    """

    factor: Array
    name: str = "I"
    concave: bool = True
    smooth: bool = True

    def value(self, m: Array) -> float:
        """-log tr(W M^-1)."""
        if not is_positive_definite(m):
            return -np.inf
        return -float(np.log(np.sum((self.factor @ inverse(m)) * self.factor)))

    def support(self, m: Array) -> Support:
        """Root M^-1 F^T / sqrt(t).

        For every R (n, r), 1 / t' <= tr(R^T M' R) / tr(F R)^2 (Cauchy and Schwarz), and
        the line's height is computed from the root: rounding of the root itself never
        brings the line below phi.
        """
        half = np.linalg.inv(np.linalg.cholesky(m))
        projected = half @ self.factor.T
        t = float(np.sum(projected * projected))
        root = half.T @ projected / np.sqrt(t)
        return Support(-2.0 * float(np.log(np.sum(self.factor.T * root))), root)

    def curvature(self, m: Array, blocks: Array) -> Array:
        """2 tr(A_i M^-1 A_j S) - g_i g_j."""
        root = self.support(m).root
        g = slopes(blocks, root)
        traces = 2.0 * pairwise_traces(blocks, inverse(m), root @ root.T)
        return traces - np.outer(g, g)

    def values_after_adding(self, m: Array, blocks: Array) -> Array:
        """t less tr((1 + X M^-1 X^T)^-1 X M^-1 W M^-1 X^T)."""
        inverted = inverse(m)
        projected = inverted @ self.factor.T
        t = float(np.sum(projected * self.factor.T))
        reduction = variance_reduction(blocks, inverted, projected @ projected.T)
        return -np.log(np.maximum(t - reduction, 1e-300))

    def conventional_value(self, value: float, readings: int) -> float:
        """-tr(W M^-1)."""
        return -float(np.exp(-value))

    def restrict(self, basis: Array) -> Criterion:
        """The variances of the part of each row in the basis.

        Raises ValueError where the combination c leaves the basis.
        """
        factor = self.factor @ basis
        whole_size, inside_size = np.linalg.norm(self.factor), np.linalg.norm(factor)
        if self.name == "c" and inside_size < (1 - 1e-8) * whole_size:
            raise ValueError(
                "no reading determines the combination c: choose another, or give more"
                " candidates"
            )
        return dataclasses.replace(self, factor=factor)

    def continuation(self) -> tuple[Criterion, ...]:
        """Itself alone."""
        return (self,)


def variance_reduction(blocks: Array, inverted: Array, weighted: Array) -> Array:
    """tr((1 + X P X^T)^-1 X T X^T) (C,) for P `inverted` and T `weighted` (n, n).

    With P = M^-1 and T = M^-1 W M^-1: how much each block lowers tr(W M^-1).
    """
    numerator = inner_products(blocks, weighted)
    leverage = inner_products(blocks, inverted)
    if blocks.shape[1] == 1:
        return numerator[:, 0, 0] / (1.0 + leverage[:, 0, 0])
    identity = np.eye(blocks.shape[1])
    solved = np.linalg.solve(leverage + identity, numerator)
    return np.asarray(np.trace(solved, axis1=1, axis2=2))
