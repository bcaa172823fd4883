"""Inner products of changes of the readings, less what the parameters absorb."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw


class Metric:
    """Inner products <u, v> = u^T M v with M = (Sigma + H Lambda H^T)^-1.

    u, v are (N, k) changes of the readings in units of the stated noise.
    """

    def __init__(
        self, problem: GapProblem, law: NoiseLaw, rows: Index | None = None
    ) -> None:
        """Factor M for the readings `rows`, all by default.

        Vectors passed to the methods still have all N readings.
        """
        self._factor = law.factor(problem, rows)
        self.size = len(self._factor.order)
        white = self.whiten(problem.slopes)
        inner = np.eye(white.shape[1]) + white.T @ white
        self._root = linalg.cholesky(inner, lower=True, check_finite=False)
        self._absorb = linalg.solve_triangular(
            self._root, white.T, lower=True, check_finite=False
        )
        #: log determinant of Sigma + H Lambda H^T
        axes, triangle = linalg.qr(white, mode="economic", check_finite=False)
        rotation, size, _ = linalg.svd(triangle, check_finite=False)
        self._axes = axes @ rotation[:, : len(size)]
        self._shrink = 1.0 - 1.0 / np.hypot(1.0, size)
        log_root = float(np.log(np.diag(self._root)).sum())
        self.log_det = self._factor.log_det + 2.0 * log_root

    def whiten(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened by the noise alone, run after run."""
        return _by_column(self._factor.whiten, values)

    def parts(self, values: Array) -> tuple[Array, Array]:
        """Parts (u0, u1) of values u (N, k): <u, v> = u0^T v0 - u1^T v1."""
        white = self.whiten(values)
        return white, self._absorb @ white

    def scores(self, values: Array) -> Array:
        """Vectors s (N, k) of values u (N, k) with <u, v> = s_u^T s_v."""
        return self.remaining(self.whiten(values))

    def remaining(self, white: Array) -> Array:
        """Whitened values (N, k) less what the parameters absorb of them.

        What they absorb almost whole keeps its digits, which the difference of `parts`
        loses.
        """
        along = self._axes.T @ white
        return np.asarray(white - (self._axes * self._shrink) @ along)

    def fit(self, values: Array) -> Array:
        """Parameters (n,) or (n, k), in prior sd, that explain values (N,) or (N, k)."""
        _, absorbed = self.parts(values)
        return np.asarray(
            linalg.solve_triangular(
                self._root, absorbed, lower=True, trans="T", check_finite=False
            )
        )

    def gram(self, u: Array, v: Array) -> Array:
        """Inner products (k, l) of (N, k) and (N, l)."""
        return self.scores(u).T @ self.scores(v)


def _by_column(whiten: Callable[[Array], Array], values: Array) -> Array:
    """Values (N,) or (N, k) by what whitens columns (N, k)."""
    return whiten(values[:, None])[:, 0] if values.ndim == 1 else whiten(values)
