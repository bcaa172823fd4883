"""Prediction of held-out readings from the others by Gaussian conditioning."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw

#: posterior precision (n, n) of coefficients, and its product (n,) with their mean
Information = tuple[Array, Array]


class RunNoise:
    """Noise of the runs: innovations of held-out readings given the others of a run."""

    def __init__(self, problem: GapProblem, law: NoiseLaw) -> None:
        self._blocks = problem.members
        count = len(problem.members)
        self._inverse = [_inverse(law.block(problem, k)) for k in range(count)]

    def information(self, slopes: Array, residual: Array) -> Information:
        """Information on the coefficients of slopes (N, n), prior N(0, I).

        All readings count.
        """
        values = np.column_stack([slopes, residual])
        product = np.zeros((slopes.shape[1], values.shape[1]))
        for members, inverse in zip(self._blocks, self._inverse, strict=True):
            product += slopes[members].T @ (inverse @ values[members])
        return product[:, :-1] + np.eye(len(product)), product[:, -1]

    def innovations(self, held: Index, values: Array) -> Array:
        """Values (N, k) at held-out readings less their prediction, whitened.

        The training readings of their run predict their noise. With O the inverse
        covariance and O_hh = L L^T they are L^-1 (O v)_h, in the order of `held`.
        """
        white = np.empty((len(held), values.shape[1]))
        place = np.full(len(values), -1, dtype=np.intp)
        place[held] = np.arange(len(held))
        for members, inverse in zip(self._blocks, self._inverse, strict=True):
            rows = np.flatnonzero(place[members] >= 0)
            if rows.size:
                precision = inverse[np.ix_(rows, rows)]
                factor = _cholesky(precision)
                scored = inverse[rows] @ values[members]
                white[place[members[rows]]] = _solve(factor, scored)
        return white


def _cholesky(matrix: Array) -> Array:
    return np.asarray(linalg.cholesky(matrix, lower=True, check_finite=False))


def _solve(factor: Array, values: Array, trans: str = "N") -> Array:
    """Solution of a lower triangular system, or of its transpose (`T`)."""
    return np.asarray(
        linalg.solve_triangular(
            factor, values, lower=True, trans=trans, check_finite=False
        )
    )


def _inverse(covariance: Array) -> Array:
    factor = linalg.cho_factor(covariance, lower=True, check_finite=False)
    identity = np.eye(len(covariance))
    return np.asarray(linalg.cho_solve(factor, identity, check_finite=False))


def learn(information: Information, white: Array) -> tuple[Array, float]:
    """Mean (n,) of the coefficients from the training readings, and log evidence.

    The log evidence is up to a constant.

    information    of all readings
    white          (m, n + 1) innovations of the held-out slopes and residuals, whose
                   information is taken off
    """
    precision, product = information
    slopes, residual = white[:, :-1], white[:, -1]
    factor = _cholesky(precision - slopes.T @ slopes)
    half = _solve(factor, product - slopes.T @ residual)
    mean = _solve(factor, half, "T")
    log_det = float(np.log(np.diag(factor)).sum())
    return mean, 0.5 * float(half @ half) - log_det


def standardise(
    information: Information,
    n: int,
    white: Array,
    after: Array,
) -> tuple[Array, Array]:
    """Held-out residuals (m,) without and with the effects, standardised.

    Both are whitened by the predictive covariance without the effects.

    information    of all readings; the first n coefficients are the parameters
    n              number of parameters
    white          (m, .) innovations: the parameters' slopes first, residuals last
    after          (m,) residuals with the effects
    """
    alone = np.column_stack([white[:, :n], white[:, -1]])
    precision, product = information[0][:n, :n], information[1][:n]
    mean, _ = learn((precision, product), alone)
    slopes = alone[:, :-1]
    root = _cholesky(precision - slopes.T @ slopes)
    spread = _solve(root, slopes.T)
    factor = _cholesky(np.eye(len(alone)) + spread.T @ spread)
    before = alone[:, -1] - slopes @ mean
    white_residuals = _solve(factor, np.column_stack([before, after]))
    return white_residuals[:, 0], white_residuals[:, 1]
