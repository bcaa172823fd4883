"""Weights under linear limits: the most that they can carry, and the nearest ones.

The weights satisfy 0 <= w_i <= cap_i, sum_i w_i = N, L w <= l. For any prices p >= 0 of
the limits, g^T w <= p^T l + (g - L^T p)^T w. The right side is largest for candidates
filled to their caps, which bounds what slopes g can carry. A linear solver gives good
prices; the bound holds for any.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy import optimize, sparse

from oed.base import Array
from oed.design.certificate import knapsack_value


@dataclasses.dataclass(frozen=True, eq=False)
class Polytope:
    """The feasible weights; limits are kept to 1e-7 of a weight.

    size   N
    caps   (C,)
    rows   (L, C) of the limits rows w <= upper
    upper  (L,)
    """

    size: float
    caps: Array
    rows: Array
    upper: Array

    def maximise(self, gains: Array) -> tuple[float, Array]:
        """A bound of sum_i w_i gains_i, and weights (C,) that (nearly) attain it."""
        if not len(self.upper):
            weights = self._fill_to_caps(gains)
            return knapsack_value(gains, self.size, self.caps), weights
        scale = max(float(np.abs(gains).max()), 1e-300)
        solution = self._solve_linear(-gains / scale, self.rows, self.upper)
        marginals = np.asarray(solution.ineqlin.marginals, dtype=float)
        prices = scale * np.maximum(-marginals, 0.0)
        reduced = gains - prices @ self.rows
        bound = float(prices @ self.upper)
        bound += knapsack_value(reduced, self.size, self.caps)
        return bound, np.asarray(solution.x)

    def _fill_to_caps(self, gains: Array) -> Array:
        """Weights that fill the candidates with the largest gains to their caps."""
        order = np.argsort(-gains, kind="stable")
        caps, weights = self.caps[order], np.zeros(len(gains))
        weights[order] = np.clip(self.size - (np.cumsum(caps) - caps), 0.0, caps)
        return weights

    def nearest(self, weights: Array) -> Array:
        """The feasible weights with the least sum of differences from `weights`.

        Raises ValueError where no weights are feasible.
        """
        weights = np.clip(weights, 0.0, self.caps)
        if not len(self.upper):
            return self._rescale(weights)
        # variables: the weights w, and the differences d >= |w - weights|
        one = sparse.eye_array(len(weights))
        rows = sparse.csr_array(self.rows)
        matrix = sparse.block_array([[rows, None], [one, -one], [-one, -one]])
        upper = np.concatenate([self.upper, weights, -weights])
        cost = np.repeat([0.0, 1.0], len(weights))
        solution = self._solve_linear(cost, matrix, upper)
        return np.asarray(np.clip(solution.x[: len(weights)], 0.0, self.caps))

    def _rescale(self, weights: Array) -> Array:
        """Weights scaled down, or raised in proportion to the room below the caps."""
        missing = self.size - weights.sum()
        if missing <= 0.0:
            return np.asarray(weights * (self.size / weights.sum()))
        room = self.caps - weights
        if missing > room.sum() * (1 + 1e-12):
            raise ValueError(
                f"caps of {self.caps.sum():g} in all cannot carry a weight of"
                f" {self.size:g}"
            )
        return np.asarray(weights + room * min(missing / room.sum(), 1.0))

    def _solve_linear(self, cost: Array, matrix: Any, upper: Array) -> Any:
        """Minimises cost^T x; the first variables are weights, others positive."""
        count, extra = len(self.caps), len(cost) - len(self.caps)
        sum_row = np.repeat([1.0, 0.0], [count, extra])[None]
        bounds = np.zeros((len(cost), 2))
        bounds[:, 1] = np.append(self.caps, np.full(extra, np.inf))
        solution = optimize.linprog(
            cost, matrix, upper, sum_row, [self.size], bounds, method="highs"
        )
        if solution.status != 0:
            raise ValueError(
                f"no weights keep size, caps and limits: {solution.message}"
            )
        return solution
