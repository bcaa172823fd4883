"""Prediction of held-out readings from the others by Gaussian conditioning."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.gap.data.problem import GapProblem
from oed.noise.factor import DenseFactor, LinearFactor
from oed.noise.hold_out import Chains, DenseInnovations, Innovations, LinearInnovations
from oed.noise.law import NoiseLaw
from oed.noise.shared import SharedFactor

#: posterior precision (n, n) of coefficients, and its product (n,) with their mean
Information = tuple[Array, Array]


class RunNoise:
    """Noise of the runs: innovations of held-out readings given the others of a run."""

    def __init__(self, problem: GapProblem, law: NoiseLaw) -> None:
        self._factor = law.factor(problem)
        self._chains: Chains | None = None
        if isinstance(self._factor, LinearFactor):
            if Chains.suit(self._factor.errors):
                self._chains = Chains(self._factor.errors)
            else:
                self._factor = law.dense_factor(problem)

    def score(self, values: Array) -> Array:
        """The noise's precision times values (N, k), as `Innovations` wants it."""
        return self._factor.scored(self._factor.standardise(values))

    def information(self, slopes: Array, scored: Array) -> Information:
        """Information on the coefficients of slopes (N, n), prior N(0, I).

        All readings count. `scored` (N, n + 1) is of the slopes and the residual.
        """
        product = self._factor.standardise(slopes).T @ scored
        return product[:, :-1] + np.eye(len(product)), product[:, -1]

    def hold_out(self, held: Index) -> Innovations:
        """Readings held out; those of their run predict their noise."""
        factor = self._factor
        if isinstance(factor, DenseFactor):
            return DenseInnovations(factor, held)
        assert isinstance(factor, LinearFactor)
        assert self._chains is not None
        return LinearInnovations(factor, self._chains, held)


def _cholesky(matrix: Array) -> Array:
    return np.asarray(linalg.cholesky(matrix, lower=True, check_finite=False))


def _solve(factor: Array, values: Array, trans: str = "N") -> Array:
    """Solution of a lower triangular system, or of its transpose (`T`)."""
    return np.asarray(
        linalg.solve_triangular(
            factor, values, lower=True, trans=trans, check_finite=False
        )
    )


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
    spread = SharedFactor(_solve(root, slopes.T).T, np.zeros(1, dtype=np.intp))
    before = alone[:, -1] - slopes @ mean
    white_residuals = spread.whiten(np.column_stack([before, after]))
    return white_residuals[:, 0], white_residuals[:, 1]
