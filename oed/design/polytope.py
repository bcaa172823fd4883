"""Weights under linear limits: 0 <= w_i <= cap_i, sum_i w_i = N, L w <= l; what they
can carry, and the nearest ones.

For any prices p >= 0 of the limits, g^T w <= p^T l + (g - L^T p)^T w, and the last is
largest for candidates filled to their caps: a bound of what slopes g can carry. A
linear solver tells good prices; the bound holds for any.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy import optimize

from oed.arrays import Array
from oed.design.certificate import carried


@dataclasses.dataclass(frozen=True, eq=False)
class Polytope:
    """The weights allowed: sum `size`, caps (C,), limits (L, C) w <= (L,). Limits are
    kept to 1e-7 of a weight.
    """

    size: float
    caps: Array
    limits: tuple[Array, Array]

    def most(self, gains: Array) -> tuple[float, Array]:
        """A bound of sum_i w_i gains_i over all weights, and weights (C,) that (nearly)
        attain it.
        """
        rows, most = self.limits
        if not len(most):
            order = np.argsort(-gains, kind="stable")
            filled, weights = self.caps[order], np.zeros(len(gains))
            weights[order] = np.clip(
                self.size - (np.cumsum(filled) - filled), 0.0, filled
            )
            return carried(gains, self.size, self.caps), weights
        scale = max(float(np.abs(gains).max()), 1e-300)
        found = self._linear(-gains / scale, rows, most)
        price = scale * np.maximum(
            -np.asarray(found.ineqlin.marginals, dtype=float), 0.0
        )
        return float(price @ most) + carried(
            gains - price @ rows, self.size, self.caps
        ), np.asarray(found.x)

    def nearest(self, weights: Array) -> Array:
        """Weights allowed, at the least sum of differences from `weights`. Raises
        ValueError where there are none.
        """
        weights = np.clip(weights, 0.0, self.caps)
        rows, most = self.limits
        if not len(most):
            lack = self.size - weights.sum()
            if lack <= 0.0:
                return np.asarray(weights * (self.size / weights.sum()))
            room = self.caps - weights
            if lack > room.sum() * (1 + 1e-12):
                raise ValueError(
                    f"caps of {self.caps.sum():g} in all cannot carry a weight of"
                    f" {self.size:g}"
                )
            return np.asarray(weights + room * min(lack / room.sum(), 1.0))
        one = np.eye(len(weights))
        above = np.block([[rows, np.zeros(rows.shape)], [one, -one], [-one, -one]])
        cost = np.repeat([0.0, 1.0], len(weights))
        found = self._linear(cost, above, np.concatenate([most, weights, -weights]))
        return np.asarray(np.clip(found.x[: len(weights)], 0.0, self.caps))

    def _linear(self, cost: Array, above: Array, most: Array) -> Any:
        count, more = len(self.caps), len(cost) - len(self.caps)
        ones, bounds = (
            np.repeat([1.0, 0.0], [count, more])[None],
            np.zeros((len(cost), 2)),
        )
        bounds[:, 1] = np.append(self.caps, np.full(more, np.inf))
        found = optimize.linprog(
            cost, above, most, ones, [self.size], bounds, method="highs"
        )
        if found.status != 0:
            raise ValueError(f"no weights keep size, caps and limits: {found.message}")
        return found
