"""Fit of readings for checks: maximum a posteriori, and the precision of prediction.

With tolerances T and noise covariance S, readings have the covariance C = J T^2 J^T + S
about those of the nominal machine. At the maximum a posteriori the penalised sum of
squares |W (y - f)|^2 + |z|^2 is r^T C^-1 r, and chi-squared of N degrees of freedom.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.checks.session import SessionReadings
from oed.estimation.fitter import minimise
from oed.estimation.readings_problem import ReadingsProblem
from oed.noise.covariance import Noise

#: steps of one fit
MOST_STEPS = 30


@dataclasses.dataclass(frozen=True)
class Fit:
    """Readings fitted within the tolerances.

    session    the readings
    theta      (n,) parameters, SI
    penalised  sum of squares of whitened residuals and scaled parameters
    residual   (N,) whitened residual
    slopes     (N, r) whitened slopes over free parameters in their tolerances
    departure  (r,) free parameters from nominal, in their tolerances
    noise      of the readings
    scale      factor on their noise that the fit assumes
    """

    session: SessionReadings
    theta: Array
    penalised: float
    residual: Array
    slopes: Array
    departure: Array
    noise: Noise
    scale: float = 1.0

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.residual @ self.residual)

    @property
    def ratio(self) -> float:
        """Penalised sum of squares over its expectation, as a ratio of amplitudes.

        It is in units of the noise without the factor.
        """
        square = self.scale**2 * self.chi2 + float(self.departure @ self.departure)
        return float(np.sqrt(square / max(len(self.residual), 1)))

    def remaining(self) -> float:
        """Root mean square of the residuals over the noise without its factor."""
        return self.scale * float(np.sqrt(np.mean(self.residual**2)))

    def parameter(self, name: str) -> tuple[Array, Array]:
        """Departure (1,) of a parameter from nominal, and its standard deviation, SI."""
        measurement = self.session.measurement
        k = measurement.names.index(name)
        row = self.session.prior_root()[k] @ self.half_covariance()
        departure = self.theta[k] - measurement.nominal[k]
        return np.array([departure]), np.array([np.linalg.norm(row)])

    def linear_residual(self) -> Array:
        """Whitened residual (N,) about the nominal machine, linear at the solution."""
        return self.residual + self.slopes @ self.departure

    def half_covariance(self) -> Array:
        """L (r, r) with L L^T = (1 + A^T A)^-1, A the slopes."""
        return half_covariance(self.slopes)

    def weights(self) -> Array:
        """Weights (N,) of independent chi-squared terms whose sum chi2 is distributed as.

        They are the eigenvalues of 1 - A (1 + A^T A)^-1 A^T.
        """
        return residual_weights(self.slopes)


def fit(
    session: SessionReadings, start: Array | None = None, scale: float = 1.0
) -> Fit | None:
    """Fit a session from `start` (n,), or from nominal; None where it cannot be read.

    scale  factor on the noise
    """
    measurement = session.measurement
    noise, root = session.noise().scaled(scale), session.prior_root()
    free = np.flatnonzero(measurement.free)
    nominal = measurement.nominal
    first: Array = np.zeros(len(free))
    if start is not None:
        first = linalg.solve(root[free], start[free] - nominal[free])
    problem = ReadingsProblem(
        measurement, session.series, noise, session.y[None], nominal[None], root
    )
    try:
        minima = minimise(problem, first[None], steps=MOST_STEPS)
    except (ArithmeticError, ValueError, RuntimeError, linalg.LinAlgError):
        return None
    residual, departure = minima.residual[0], minima.z[0]
    # the distance of a pose from itself has no slope
    if not (np.isfinite(residual).all() and np.isfinite(minima.slopes[0]).all()):
        return None
    return Fit(
        session=session,
        theta=np.asarray(nominal + root @ departure),
        penalised=float(residual @ residual + departure @ departure),
        residual=residual,
        slopes=minima.slopes[0],
        departure=departure,
        noise=noise,
        scale=scale,
    )


def residual_weights(slopes: Array) -> Array:
    """Eigenvalues (N,) of 1 - A (1 + A^T A)^-1 A^T, A whitened slopes (N, r)."""
    count = len(slopes)
    singular = linalg.svdvals(slopes)[:count]
    return np.concatenate([1.0 / (1.0 + singular**2), np.ones(count - len(singular))])


def half_covariance(slopes: Array) -> Array:
    """L (r, r) with L L^T = (1 + A^T A)^-1, A the slopes (N, r)."""
    # by singular values: a sum of large squares would lose the 1
    count = min(slopes.shape)
    triangle = linalg.qr(slopes, mode="r")[0][:count]
    _, singular, vectors = linalg.svd(triangle, full_matrices=True)
    size = np.zeros(len(vectors))
    size[: len(singular)] = singular
    return np.asarray(vectors.T / np.hypot(1.0, size))


@dataclasses.dataclass(frozen=True)
class LeaveOneOut:
    """Each reading against what all others predict, by the precision P = C^-1.

    gradient  (N,) P r
    diagonal  (N,) of P
    factor    (N, r) B, with P = S^-1 - B B^T
    noise     of covariance S
    """

    gradient: Array
    diagonal: Array
    factor: Array
    noise: Noise

    def columns(self, members: Index) -> Array:
        """Columns (N, k) of P."""
        unit = np.zeros((len(self.diagonal), len(members)))
        unit[members, np.arange(len(members))] = 1.0
        alone = self.noise.precision(unit)
        return alone - self.factor @ self.factor[members].T

    def without(self, members: Index) -> tuple[Array, Array]:
        """Gradient and diagonal (N,), with the values `members` (k,) left out.

        Entries of `members` are 0 and 1.
        """
        if not len(members):
            return self.gradient, self.diagonal
        if self.noise.is_independent:
            gradient, diagonal = self._without_independent(members)
        else:
            gradient, diagonal = self._without_related(members)
        gradient[members], diagonal[members] = 0.0, 1.0
        return gradient, np.maximum(diagonal, 1e-12 * self.diagonal)

    def _without_independent(self, members: Index) -> tuple[Array, Array]:
        """The same where S is diagonal: what is left out changes B B^T alone.

        With U the rows of B that are left out, and D their part of S^-1, it becomes
        B K^-1 B^T, K = 1 - U^T D^-1 U (Woodbury): linear in the number of readings,
        however many are left out.
        """
        alone = self.noise.precision_diagonal()
        out = self.factor[members]
        scaled = out / alone[members, None]
        lower = linalg.cholesky(np.eye(out.shape[1]) - out.T @ scaled, lower=True)
        known = linalg.cho_solve((lower, True), scaled.T @ self.gradient[members])
        half = linalg.solve_triangular(lower, self.factor.T, lower=True)
        diagonal = alone - np.einsum("ij,ij->j", half, half)
        return self.gradient + self.factor @ known, diagonal

    def _without_related(self, members: Index) -> tuple[Array, Array]:
        """The same for any S, by the columns of P that are left out."""
        columns = self.columns(members)
        lower = linalg.cholesky(columns[members], lower=True)
        half = linalg.solve_triangular(lower, columns.T, lower=True)
        known = linalg.solve_triangular(lower, self.gradient[members], lower=True)
        gradient = self.gradient - half.T @ known
        diagonal = self.diagonal - np.einsum("ij,ij->j", half, half)
        return gradient, diagonal


def predict_from_others(solution: Fit) -> LeaveOneOut:
    """What all other readings predict of each reading, linear at the solution."""
    noise = solution.noise
    half = solution.half_covariance()
    shared = solution.slopes @ half
    r = solution.linear_residual()
    remainder = r - shared @ (shared.T @ r)
    factor = noise.whiten_back(shared)
    diagonal = noise.precision_diagonal() - np.einsum("ij,ij->i", factor, factor)
    return LeaveOneOut(noise.whiten_back(remainder), diagonal, factor, noise)
