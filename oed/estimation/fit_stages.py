"""Stages of a fit with known noise: least squares in identifiable coordinates."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.estimation.coordinates import IdentifiableCoordinates, ReadingsProblem
from oed.estimation.estimate import Estimate, FitStage
from oed.estimation.fitter import MAX_TRIALS, minimise
from oed.identifiability import posterior_covariance
from oed.measurement import Measurement, Series
from oed.noise import Noise, ReadingStructure


class IdentificationError(RuntimeError):
    """The readings cannot be fitted: too few, not finite, or without convergence."""


@dataclasses.dataclass(frozen=True)
class ReadingsFit:
    """Readings y (N,) of a measurement, and how they are fitted."""

    measurement: Measurement
    series: Sequence[Series]
    y: Array
    stated: Noise
    max_iterations: int

    def check_readings(self) -> None:
        """Raise IdentificationError for a wrong number of readings, or NaN."""
        expected = len(self.measurement.setup_of_readings(self.series))
        if self.y.shape != (expected,):
            raise IdentificationError(
                f"{expected} readings were planned, {self.y.shape} are given"
            )
        bad = np.flatnonzero(~np.isfinite(self.y))
        if bad.size:
            raise IdentificationError(
                f"readings number {bad[:5].tolist()} are not finite"
            )

    def tolerances(self, patterns: Sequence[str]) -> Array:
        """Prior standard deviations (n,), 0 where no pattern frees a parameter."""
        names = self.measurement.names
        freed = self.measurement.freed(patterns)
        if not freed.any():
            raise IdentificationError(
                f"the patterns {list(patterns)} free no parameter of {list(names)}"
            )
        return np.where(freed, self.measurement.tolerance, 0.0)

    def coordinates(self, theta: Array, tolerance: Array) -> IdentifiableCoordinates:
        """Identifiable coordinates with H taken at theta (n,), under the stated noise."""
        return IdentifiableCoordinates.of(
            self.measurement, self.series, theta, self.stated, tolerance
        )

    def residuals(self, theta: Array) -> Array:
        """y - f(theta) (N,), SI."""
        return self.y - self.measurement.readings(self.series, theta)

    def linearise(
        self,
        structure: ReadingStructure,
        coordinates: IdentifiableCoordinates,
        theta: Array,
    ) -> tuple[Array, Array]:
        """Standardised residuals (N,) at theta (n,), and slopes (N, r) over z."""
        jacobian = self.measurement.jacobian(self.series, theta)
        slopes = structure.standardise(jacobian @ coordinates.basis)
        return structure.standardise(self.residuals(theta)), slopes

    def closing(self, start: Array, end: Array) -> Array:
        """Parameters (n,) at the end, or halfway or less to where all poses close."""
        for halvings in range(MAX_TRIALS):
            theta = np.asarray(start + (end - start) / 2.0**halvings)
            if np.isfinite(self.measurement.try_readings(self.series, theta)).all():
                return theta
        return start

    def solve(
        self, noise: Noise, coordinates: IdentifiableCoordinates, theta: Array
    ) -> tuple[Array, int]:
        """z (r,) that minimises, from theta (n,), and the number of evaluations."""
        problem = ReadingsProblem(
            self.measurement,
            self.series,
            noise,
            self.y[None],
            coordinates.origin[None],
            coordinates.basis,
        )
        start = coordinates.from_theta(theta)[None]
        minima = minimise(problem, start, steps=self.max_iterations)
        if not minima.converged[0]:
            rms = _rms(minima.residual[0])
            raise IdentificationError(
                f"the fit did not converge in {self.max_iterations} iterations (the"
                f" residuals are {rms:.3g} times the noise); check units and signs of the"
                " readings, or free fewer parameters in a stage before"
            )
        return minima.z[0], int(minima.evaluations[0])

    def covariance(self, theta: Array, tolerance: Array) -> tuple[Array, Array]:
        """Covariance (n, n), SI, and share (N,) of each reading it uses up."""
        freed = tolerance > 0.0
        white = self.stated.whiten(self.measurement.jacobian(self.series, theta))
        h = self.measurement.in_prior_units(white, freed)
        scaled = posterior_covariance(h)
        leverage = np.einsum("ij,jk,ik->i", h, scaled, h)
        return self.measurement.from_prior_units(scaled, freed), leverage


def preliminary_stage(
    fit: ReadingsFit, theta: Array, patterns: Sequence[str]
) -> tuple[Array, FitStage]:
    """A stage that only finds a start: theta (n,), and a summary."""
    coordinates = fit.coordinates(theta, fit.tolerances(patterns))
    z, iterations = fit.solve(fit.stated, coordinates, theta)
    solution = coordinates.to_theta(z)
    ends = fit.residuals(theta), fit.residuals(solution)
    return solution, _summary(fit, patterns, iterations, ends)


def last_stage(fit: ReadingsFit, theta: Array, patterns: Sequence[str]) -> Estimate:
    """The last stage from theta (n,), with the stated noise."""
    before, tolerance = fit.residuals(theta), fit.tolerances(patterns)
    # Twice: the coordinates of the result are those of H at the result.
    for _ in range(2):
        coordinates = fit.coordinates(theta, tolerance)
        z, iterations = fit.solve(fit.stated, coordinates, theta)
        theta = coordinates.to_theta(z)
    residuals = fit.residuals(theta)
    covariance, leverage = fit.covariance(theta, tolerance)
    white = fit.stated.whiten(residuals)
    return Estimate(
        theta=theta,
        covariance=covariance,
        prior_sd=tolerance,
        coordinates=coordinates,
        z=z,
        residuals=residuals,
        residuals_before=before,
        noise=fit.stated,
        dof=len(fit.y) - float(leverage.sum()),
        chi2=float(white @ white),
        stages=(_summary(fit, patterns, iterations, (before, residuals)),),
        warnings=(),
    )


def _summary(
    fit: ReadingsFit,
    patterns: Sequence[str],
    iterations: int,
    ends: tuple[Array, Array],
) -> FitStage:
    """A stage by the residuals (N,), SI, where it starts and ends."""
    before, after = (_rms(fit.stated.whiten(residuals)) for residuals in ends)
    return FitStage(tuple(patterns), iterations, before, after)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
