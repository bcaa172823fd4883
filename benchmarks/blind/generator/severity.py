"""Severity of an effect, its visibility to the best possible test: lambda = dy^T M dy.

M = (Sigma + J Lambda J^T)^-1. dy is the exact nonlinear difference of the noise-free
readings, J the slopes over parameters and set-up unknowns at the true machine, Lambda
their tolerances squared. A flat direction (another effect, of free size) can be
absorbed as well.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg

from benchmarks.blind.generator.machines import Array

Size = Callable[[Array], float]


class Metric:
    """The metric M of a case, with coordinates in which it is the identity."""

    def __init__(self, sigma: Array, J: Array, prior: Array) -> None:
        self._root = linalg.cholesky(sigma, lower=True, check_finite=False)
        self._J = self._white(J * prior)
        u, s, _ = linalg.svd(self._J, full_matrices=False, check_finite=False)
        self._u, self._shrink = u, 1.0 - 1.0 / np.sqrt(1.0 + s**2)

    def _white(self, v: Array) -> Array:
        return np.asarray(
            linalg.solve_triangular(self._root, v, lower=True, check_finite=False)
        )

    def embed(self, v: Array) -> Array:
        """M^1/2 v for v (N,) or (N, k)."""
        w = self._white(v)
        shrink = self._shrink if w.ndim == 1 else self._shrink[:, None]
        return np.asarray(w - self._u @ (shrink * (self._u.T @ w)))

    def size(self, v: Array) -> float:
        """sqrt(lambda) of a difference of readings v (N,)."""
        return float(np.linalg.norm(self.embed(v)))

    def size_without(self, direction: Array) -> Size:
        """As `size`, once a direction (N,) in the metric's coordinates is absorbed."""
        unit = direction / np.linalg.norm(direction)

        def size(v: Array) -> float:
            embedded = self.embed(v)
            return float(np.linalg.norm(embedded - (embedded @ unit) * unit))

        return size


def distance(vector: Array, columns: Array) -> float:
    """Length of what columns (N, k) cannot absorb of a vector (N,).

    All are in the metric's coordinates; the columns' sizes are free.
    """
    size = np.linalg.norm(columns, axis=0)
    least = 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
    regular = columns[:, size > least]
    if not regular.shape[1]:
        return float(np.linalg.norm(vector))
    regular = regular / np.linalg.norm(regular, axis=0)
    values, vectors = np.linalg.eigh(regular.T @ regular)
    good = values > 1e-10 * values[-1]
    share = vectors[:, good].T @ (regular.T @ vector)
    absorbed = float((share**2 / values[good]).sum())
    return float(np.sqrt(max(float(vector @ vector) - absorbed, 0.0)))


def amplitude(
    change: Callable[[float], Array], size: Size, target: float, start: float
) -> float:
    """The amplitude a at which `size(change(a))` is the target.

    Secant steps from `start`. Raises ArithmeticError.
    """
    a0, f0 = 0.0, 0.0
    a = start
    for _ in range(8):
        f = size(change(a))
        if not np.isfinite(f) or f <= 1e-12:
            raise ArithmeticError("this effect leaves no trace in the readings")
        if abs(f - target) < 2e-4 * target:
            return a
        slope = (f - f0) / (a - a0)
        a0, f0, a = a, f, a + (target - f) / slope if slope > 0 else a * target / f
        if a <= 0:
            a = a0 * target / f0
    if abs(f - target) < 0.01 * target:
        return a0
    raise ArithmeticError(f"no amplitude gives sqrt(lambda) {target}: {f} at {a0}")


def expected_closure(covariance: Array, change: Array, test: Array) -> dict[str, float]:
    """Closure C that whoever knows the shape of a change (N,) and fits its size expects.

    covariance (N, N) is that of noise and geometry together; test (N,) marks the
    readings that are held out, of which `gain` is the expected fall of the score.
    """
    train = ~test
    inner = covariance[np.ix_(train, train)]
    across = covariance[np.ix_(train, test)]
    weights = np.linalg.solve(inner, across).T
    shown = change[test] - weights @ change[train]
    rest = covariance[np.ix_(test, test)] - weights @ across
    energy = float(change[train] @ np.linalg.solve(inner, change[train]))
    gain = float(shown @ np.linalg.solve(rest, shown))
    return {"C": 1.0 - 1.0 / max(energy, 1.0), "gain": gain}
