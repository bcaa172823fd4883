"""Inner products of changes of the readings, less what the parameters absorb."""

from __future__ import annotations

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
        self._factor = law.factor(problem.structure, rows)
        self.size = len(self._factor.order)
        axes, triangle = linalg.qr(
            self.whiten(problem.slopes), mode="economic", check_finite=False
        )
        rotation, size, self._turn = linalg.svd(
            triangle, full_matrices=False, check_finite=False
        )
        #: what the parameters absorb lies along these axes (N, k), of these sizes (k,)
        self._axes, self._size = axes @ rotation, size[:, None]
        #: log determinant of Sigma + H Lambda H^T
        self.log_det = self._factor.log_det + float(np.log1p(size**2).sum())

    def whiten(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened by the noise alone, run after run."""
        if values.ndim == 1:
            return self._factor.whiten(values[:, None])[:, 0]
        return self._factor.whiten(values)

    def parts(self, values: Array) -> tuple[Array, Array]:
        """Parts (u0, u1) of values u (N, k): <u, v> = u0^T v0 - u1^T v1."""
        white = self.whiten(values)
        share = self._size / np.hypot(1.0, self._size)
        return white, share * (self._axes.T @ white)

    def scores(self, values: Array) -> Array:
        """Vectors s (N, k) of values u (N, k) with <u, v> = s_u^T s_v."""
        return self.remaining(self.whiten(values))

    def remaining(self, white: Array) -> Array:
        """Whitened values (N, k) less what the parameters absorb of them.

        What they absorb almost whole keeps its digits, which the difference of `parts`
        loses.
        """
        shrink = 1.0 - 1.0 / np.hypot(1.0, self._size)
        return np.asarray(white - self._axes @ (shrink * (self._axes.T @ white)))

    def fit(self, values: Array) -> Array:
        """Parameters (n,) or (n, k), in prior sd, that explain values (N,) or (N, k)."""
        columns = values[:, None] if values.ndim == 1 else values
        along = self._axes.T @ self.whiten(columns)
        fitted = self._turn.T @ (self._size / (1.0 + self._size**2) * along)
        return np.asarray(fitted[:, 0] if values.ndim == 1 else fitted)

    def gram(self, u: Array, v: Array) -> Array:
        """Inner products (k, l) of (N, k) and (N, l)."""
        return self.scores(u).T @ self.scores(v)

    def posterior(self, columns: Array, values: Array) -> tuple[Array, Array]:
        """Mean (k,) and precision (k, k) of coefficients of prior N(0, 1).

        They are of columns (N, k) that explain values (N,) with the parameters.
        """
        scores = self.scores(columns)
        precision = scores.T @ scores + np.eye(columns.shape[1])
        b = scores.T @ self.scores(values[:, None])[:, 0]
        return np.asarray(np.linalg.solve(precision, b)), precision
