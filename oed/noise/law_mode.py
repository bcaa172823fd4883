"""The most probable law, and how the posterior narrows about it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import optimize

from oed.base.arrays import Array
from oed.base.linear_algebra import eigenvectors

#: step of numerical slopes and curvatures, and least curvature, in prior sd
SLOPE_STEP, CURVATURE_STEP, LEAST_CURVATURE = 1e-4, 0.15, 0.5
#: Newton steps after the search, at most; a step that is none, and that of their slopes,
#: in prior sd; and by how much the cost may rise by rounding
NEWTON_STEPS, CONVERGED, FINE_STEP, ROUNDING = 6, 3e-4, 0.01, 1e-6

#: minus log posterior density (L,), up to a constant, at coordinates (L, d)
Cost = Callable[[Array], Array]


def find_mode(cost: Cost, starts: Array, farthest: float) -> Array:
    """Coordinates (d,) of least cost from some starts (s, d), none beyond `farthest`."""
    dimensions = starts.shape[1]
    steps = np.vstack([np.zeros(dimensions), np.eye(dimensions)]) * SLOPE_STEP

    def cost_and_slope(u: Array) -> tuple[float, Array]:
        costs = cost(u + steps)
        return float(costs[0]), (costs[1:] - costs[0]) / SLOPE_STEP

    limits = [(-farthest, farthest)] * dimensions
    minima = [
        optimize.minimize(
            cost_and_slope,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=limits,
            options={"maxiter": 60, "ftol": 1e-6},
        )
        for start in starts
    ]
    return np.asarray(min(minima, key=lambda minimum: minimum.fun).x)


def polish(cost: Cost, u: Array, farthest: float) -> Array:
    """Coordinates (d,) of least cost near u (d,), where `find_mode` ended.

    That search ends where the cost hardly falls any more, some hundredths away, and where
    that is depends on rounding. Newton steps go on to where the slopes vanish.
    """
    root = root_about(cost, u)
    moves = FINE_STEP * np.eye(len(u))
    moves = np.vstack([np.zeros(len(u)), moves, -moves])
    lowest, least = u, np.inf
    for _ in range(NEWTON_STEPS):
        costs = cost(u + moves)
        if costs[0] > least + ROUNDING:
            break
        lowest, least = u, float(costs[0])
        ahead, behind = np.split(costs[1:], 2)
        slope = (ahead - behind) / (2.0 * FINE_STEP)
        step = -root @ (root.T @ slope)
        if np.abs(step).max() < CONVERGED:
            break
        u = np.clip(u + step, -farthest, farthest)
    return lowest


def root_about(cost: Cost, mode: Array) -> Array:
    """Root (d, d) of the inverse curvature at the mode, no wider than is sensible."""
    d = len(mode)
    unit = CURVATURE_STEP * np.eye(d)
    pairs = [(i, j) for i in range(d) for j in range(i)]
    both = [unit[i] + unit[j] for i, j in pairs]
    points = np.vstack([np.zeros(d), unit, -unit, *both])
    costs = cost(mode + points)
    middle, ahead, behind = costs[0], costs[1 : d + 1], costs[d + 1 : 2 * d + 1]
    curvature = np.diag(ahead + behind - 2.0 * middle)
    for (i, j), value in zip(pairs, costs[2 * d + 1 :], strict=True):
        mixed = value - ahead[i] - ahead[j] + middle
        curvature[i, j] = curvature[j, i] = mixed
    values, vectors = eigenvectors(curvature / CURVATURE_STEP**2)
    root: Array = vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    return root


def signed(vectors: Array) -> Array:
    """Vectors in columns (d, k), each with its largest component positive.

    An eigenvector's sign is a matter of rounding.
    """
    largest = np.argmax(np.abs(vectors), axis=0)
    return vectors * np.sign(vectors[largest, range(vectors.shape[1])])
