"""Inner products of changes of the readings, less what the parameters absorb."""

from __future__ import annotations

import numpy as np

from oed.base import Array, Index
from oed.gap.data.problem import GapProblem
from oed.noise import NoiseLaw


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
        factor = law.factor(problem.structure, rows)
        self.size = len(factor.order)
        self._root = factor.widened(problem.slopes)
        #: log determinant of Sigma + H Lambda H^T
        self.log_det = self._root.log_det

    def whiten(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened by the noise alone, run after run."""
        if values.ndim == 1:
            return self._root.alone.whiten(values[:, None])[:, 0]
        return self._root.alone.whiten(values)

    def parts(self, values: Array) -> tuple[Array, Array]:
        """Parts (u0, u1) of values u (N, k): <u, v> = u0^T v0 - u1^T v1."""
        white, sizes = self.whiten(values), self._root.sizes[:, None]
        share = sizes / np.hypot(1.0, sizes)
        return white, share * (self._root.axes.T @ white)

    def scores(self, values: Array) -> Array:
        """Vectors s (N, k) of values u (N, k) with <u, v> = s_u^T s_v."""
        return self._root.whiten(values)

    def remaining(self, white: Array) -> Array:
        """Whitened values (N, k) less what the parameters absorb of them.

        What they absorb almost whole keeps its digits, which the difference of `parts`
        loses.
        """
        return self._root.remaining(white)

    def fit(self, values: Array) -> Array:
        """Parameters (n,) or (n, k), in prior sd, that explain values (N,) or (N, k)."""
        columns = values[:, None] if values.ndim == 1 else values
        root, sizes = self._root, self._root.sizes[:, None]
        along = root.axes.T @ self.whiten(columns)
        fitted = root.turn.T @ (sizes / (1.0 + sizes**2) * along)
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
