"""Concave objectives of the candidates' weights, for the relaxation.

`CriterionObjective` is log phi(M0 + sum w_i A_i) of one information matrix.
`oed.design.robust` has the objectives of several machines at once. An objective gives
the relaxation values, gradient, curvatures, and the bound that a tangent implies.

A line is above the criterion whatever its root R is, so that only the products X_i R
bring rounding into the bound. A block's product has an error of at most

    d_i = gamma |X_i| |R| + e_i |R|            (Frobenius norms; e_i: of the block itself)

and its slope |X_i R|^2 one of at most 2 |X_i R| d_i + d_i^2.

Such bounds hold at any dual point, whatever a solver reports: log det is concave. So
for every positive definite M and every plan w' with information M' = M0 + sum_i w'_i
A_i,

    log det M' <= log det M + tr(M^-1 M0) + sum_i w'_i tr(M^-1 A_i) - n,

and the sum is at most the knapsack value of the gradient tr(M^-1 A_i). M need not belong
to a feasible or a converged plan: the bound only gets looser. Homogeneous criteria have
tighter lines through the origin (`oed.design.forms.protocol`). What rounding can
change is added on the safe side: of the gradients, of their sum,
and of the line's logarithms.
"""

import dataclasses
import functools
from typing import Protocol

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import (
    NO_ROUNDING,
    Rounding,
    gamma,
    information,
    largest_norm,
    quotient_error,
)
from oed.design.forms.protocol import Criterion, weight_gradient

LOG_ROUNDING = 1e-12  #: allowance for the rounding of a line's logarithms, in log phi


def knapsack_value(gradient: Array, size: float, cap: Array | float) -> float:
    """max sum_i w_i slopes_i over 0 <= w_i <= cap_i, sum_i w_i = size, best first."""
    if np.ndim(cap):
        weights = knapsack_weights(gradient, size, np.asarray(cap, dtype=float))
        return float(gradient @ weights)
    cap = float(cap)
    if not np.isfinite(cap) or cap >= size:
        return float(size * gradient.max())
    full = int(size // cap)
    first = len(gradient) - min(full + 1, len(gradient))
    best = np.partition(gradient, first)[::-1]
    best = np.sort(best[: full + 1])[::-1]
    remainder = size - cap * full
    partial = remainder * best[full] if remainder > 0 else 0.0
    return float(cap * best[:full].sum() + partial)


def knapsack_weights(gradient: Array, size: float, caps: Array) -> Array:
    """Weights (C,) that fill the caps (C,), the largest slope first, to the size."""
    order = np.argsort(-gradient, kind="stable")
    weights = np.zeros(len(gradient))
    filled = np.cumsum(caps[order]) - caps[order]
    weights[order] = np.clip(size - filled, 0.0, caps[order])
    return weights


#: ridge, by the mean eigenvalue, that keeps an undetermined direction finite
RIDGE_SHARE = 1e-9


@dataclasses.dataclass(frozen=True)
class Tangent:
    """A line above the objective, which touches it at some weights.

    Every plan w' has a value of at most bound(sum_i w'_i slopes_i).
    """

    value: float  #: the objective at the weights where the line touches
    gradient: Array  #: (C,) along each candidate's weight, for all candidates
    base_term: float  #: the line's term of the prior information M0
    offset: float  #: constant of the line
    #: whether the line bounds the objective itself, instead of its exponential
    linear: bool = False
    rounding: float = 0.0  #: by how much a slope can be too low

    def bound(self, weighted_gradient: float) -> float:
        """The line's height at a plan with sum_i w'_i slopes_i = `weighted_gradient`.

        It is offset + log(base_term + weighted_gradient), without the log where linear.
        """
        height = self.base_term + weighted_gradient
        if self.linear:
            return self.offset + height
        return self.offset + float(np.log(max(height, 1e-300)))


class Objective(Protocol):
    """A concave function of the candidates' weights.

    Weights (A,) are those of an active set (A,) of candidates; all others are zero.
    """

    @property
    def count(self) -> int:
        """Number of candidates."""
        ...

    @property
    def directions(self) -> int:
        """Number of columns."""
        ...

    def value(self, active: Index, weights: Array) -> float:
        """Value at the weights; -inf where a direction is undetermined."""
        ...

    def tangent(self, active: Index, weights: Array) -> Tangent:
        """A line above the objective; it touches it, or nearly so where smoothed."""
        ...

    def derivatives(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Gradient (A,) and negative second derivatives (A, A)."""
        ...

    def subset(self, chosen: Index) -> "Objective":
        """The objective over a part of the candidates."""
        ...

    def regularised(self, weights: Array) -> "Objective":
        """The objective where weights on all candidates may leave it undetermined.

        It is itself where the prior information alone determines every direction.
        """
        return self


@dataclasses.dataclass(frozen=True, eq=False)
class CriterionObjective:
    """log phi(M0 + sum_i w_i X_i^T X_i) for blocks (C, k, n) and M0 `base` (n, n)."""

    criterion: Criterion
    blocks: Array
    base: Array
    rounding: Rounding = NO_ROUNDING

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.blocks)

    @property
    def directions(self) -> int:
        """Number of columns."""
        return int(self.blocks.shape[2])

    def information_at(self, active: Index, weights: Array) -> Array:
        """M (n, n)."""
        return self.base + information(self.blocks[active], weights)

    def value(self, active: Index, weights: Array) -> float:
        """log phi(M)."""
        return self.criterion.value(self.information_at(active, weights))

    def value_of(self, plan: Index) -> float:
        """log phi of a plan."""
        return self.criterion.value(self.base + information(self.blocks[plan]))

    def tangent(self, active: Index, weights: Array) -> Tangent:
        """The criterion's supporting line."""
        m = self.information_at(active, weights)
        offset, root = self.criterion.support(m)
        line_gradient = weight_gradient(self.blocks, root)
        return Tangent(
            value=self.criterion.value(m),
            gradient=line_gradient,
            base_term=self._base_term(root),
            offset=offset,
            rounding=self._slope_rounding(root, float(line_gradient.max())),
        )

    def _base_term(self, root: Array) -> float:
        """tr(M0 R R^T), rounded up."""
        square = float(np.sum(root * root))
        size = gamma(2 * len(root) + 2) * float(np.linalg.norm(self.base))
        term = float(np.sum((self.base @ root) * root))
        return term + (size + self.rounding.prior) * square

    def _slope_rounding(self, root: Array, largest: float) -> float:
        """By how much a slope can be too low; `largest` is the largest of all."""
        size = float(np.linalg.norm(root))
        product = gamma(len(root) + 1) * self._largest_block + self.rounding.rows
        error = 2.0 * product * size
        of_sum = gamma(self.blocks.shape[1] * root.shape[1] + 1) * largest
        return 2.0 * float(np.sqrt(largest)) * error + error**2 + of_sum

    @functools.cached_property
    def _largest_block(self) -> float:
        """Largest Frobenius norm of a block."""
        return largest_norm(self.blocks)

    def derivatives(self, active: Index, weights: Array) -> tuple[Array, Array]:
        """Gradient and curvature of log phi."""
        m = self.information_at(active, weights)
        blocks = self.blocks[active]
        first = weight_gradient(blocks, self.criterion.support(m).root)
        return first, self.criterion.curvature(m, blocks)

    def subset(self, chosen: Index) -> "CriterionObjective":
        """The objective over a part of the candidates."""
        return dataclasses.replace(self, blocks=self.blocks[chosen])

    def over_costs(self, cost: Array) -> "CriterionObjective":
        """The objective of v = cost w, for costs (C,)."""
        scaled = self.blocks / np.sqrt(cost)[:, None, None]
        errors = self.rounding.rows / float(np.sqrt(cost.min()))
        errors += quotient_error(scaled)
        rounding = self.rounding._replace(rows=errors)
        return dataclasses.replace(self, blocks=scaled, rounding=rounding)

    def regularised(self, weights: Array) -> "CriterionObjective":
        """The objective with a ridge, small beside the information at the weights."""
        return self.add_ridge(RIDGE_SHARE * self.mean_eigenvalue(weights))

    def mean_eigenvalue(self, weights: Array) -> float:
        """Mean eigenvalue of M at weights on all candidates."""
        trace = float(np.einsum("ckn,ckn,c->", self.blocks, self.blocks, weights))
        return float((trace + np.trace(self.base)) / self.directions)

    def add_ridge(self, ridge: float) -> "CriterionObjective":
        """The objective with ridge * 1 added to M0."""
        base = self.base + ridge * np.eye(len(self.base))
        return dataclasses.replace(self, base=base)
