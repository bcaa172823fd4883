"""Residuals about a point at which effects act: exact there, linear around it.

Readings y(theta, beta) of a machine with effects are, about (theta_1, beta_1),

    y = y(theta_1, beta_1) + H (theta - theta_1) + G (beta - beta_1) + e,

so that the residuals of `oed.gap.data.problem` about theta_1 lose what G beta_1 lacks of
the exact change. Effects of micrometres are linear; a leg that goes 6 % too far is not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from oed.base.arrays import Array
from oed.gap.data import problem as problems
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import exact_readings
from oed.mechanism.kinematics import AssemblyError
from oed.model.effect import Effect
from oed.noise.law import NoiseLaw

#: steps to the most probable point, and departure from its linear model that ends them
STEPS, STILL = 16, 0.3
#: halvings of a step that leads uphill
HALVINGS = 6


@dataclasses.dataclass(frozen=True)
class ActingEffectForm:
    """A form of an effect that acts.

    effect     the effect
    constants  {constant: value}
    names      (k,) of the coefficients that may differ from 0
    size       prior standard deviation of these, in expected sizes
    """

    effect: Effect
    constants: Mapping[str, float]
    names: tuple[str, ...]
    size: float


@dataclasses.dataclass(frozen=True)
class Settled:
    """Readings linearised where some forms explain them best.

    problem       with its residuals there
    coefficients  of all forms there, one after the other, in expected sizes
    departure     how far the linear model of the beginning is off where it leads: norm
                  over all readings, in units of the noise, of what parameters leave
    """

    problem: GapProblem
    coefficients: Array
    departure: float


def settle(
    problem: GapProblem,
    forms: Sequence[ActingEffectForm],
    law: NoiseLaw,
    outlying: Array,
) -> Settled:
    """The readings linearised where forms explain them best, by Gauss-Newton steps.

    outlying  (N,) what the residuals gain without outliers, in units of the noise

    Where the steps lead nowhere, the problem as it was, with a departure of infinity.
    """
    fit = _PointFit(problem, forms, law, outlying)
    place = fit.start()
    departure = None
    try:
        for _ in range(STEPS):
            reached = fit.at(fit.most_probable(place))
            off = fit.departure(place, reached)
            departure = off if departure is None else departure
            place = fit.downhill(place, reached)
            if off < STILL:
                return Settled(place.problem, fit.coefficients(place), departure)
    except AssemblyError:
        pass
    nothing = np.zeros(sum(len(form.names) for form in forms))
    return Settled(problem, nothing, np.inf)


@dataclasses.dataclass(frozen=True)
class _LinearPoint:
    """A point and the readings linearised about it.

    values   (n + k,) parameters, then coefficients, in prior standard deviations
    problem  with its residuals there
    columns  (N, k) of the forms there, per prior sd, in units of the noise
    exact    (N,) the readings of the point, in units of the noise
    """

    values: Array
    problem: GapProblem
    columns: Array
    exact: Array

    def linear(self, values: Array) -> Array:
        """Readings (N,) of another point by the linear model about this one."""
        slopes = np.hstack([self.problem.slopes, self.columns])
        return self.exact + slopes @ (values - self.values)


class _PointFit:
    """Most probable parameters and coefficients of some forms, under a noise law."""

    def __init__(
        self,
        problem: GapProblem,
        forms: Sequence[ActingEffectForm],
        law: NoiseLaw,
        outlying: Array,
    ) -> None:
        self._problem, self._forms, self._law = problem, forms, law
        self._outlying = outlying
        self._metric = Metric(problem, law)
        measurement = problem.measurement
        self._root = measurement.prior_root()[:, measurement.free]

    def start(self) -> _LinearPoint:
        """The parameters of the problem without effects, by its own linear model."""
        problem = self._problem
        off_nominal = problem.theta - problem.measurement.nominal
        parameters = np.linalg.lstsq(self._root, off_nominal, rcond=None)[0]
        columns = self._columns(problem)
        y = problem.in_noise_units(problem.y)
        exact = y - problem.residual + problem.slopes @ parameters
        values = np.concatenate([parameters, np.zeros(columns.shape[1])])
        return _LinearPoint(values, problem, columns, exact)

    def _columns(self, problem: GapProblem) -> Array:
        """Columns (N, k) of all forms, per prior sd, in units of the noise."""
        parts = []
        for form in self._forms:
            signature = problem.signature(form.effect, form.constants)
            parts.append(form.size * signature.columns_of(form.names))
        return problem.in_noise_units(np.hstack(parts))

    def at(self, values: Array) -> _LinearPoint:
        """The readings linearised about values (n + k,). Raises AssemblyError."""
        nominal = self._problem.measurement.nominal
        split = self._root.shape[1]
        theta = nominal + self._root @ values[:split]
        moved = problems.assemble(
            self._problem.measurement,
            self._problem.series,
            self._problem.covariates,
            theta,
            self._problem.y,
            gravity=self._problem.gravity,
        )
        columns = self._columns(moved)
        acting = self._acting(values[split:])
        exact = moved.in_noise_units(
            exact_readings(moved.measurement, moved.series, theta, moved.states, acting)
        )
        explained = moved.slopes @ values[:split] + columns @ values[split:]
        residual = moved.in_noise_units(moved.y) - exact + explained
        return _LinearPoint(values, moved.with_residual(residual), columns, exact)

    def _acting(
        self, coefficients: Array
    ) -> Iterator[tuple[Effect, Mapping[str, float], Mapping[str, float]]]:
        start = 0
        for form in self._forms:
            stop = start + len(form.names)
            factors = form.size * coefficients[start:stop]
            yield (
                form.effect,
                form.constants,
                dict(zip(form.names, factors.tolist(), strict=True)),
            )
            start = stop

    def coefficients(self, place: _LinearPoint) -> Array:
        """Coefficients (k,) of all forms at a place, in expected sizes."""
        sizes = [np.full(len(form.names), form.size) for form in self._forms]
        return np.concatenate(sizes) * place.values[self._root.shape[1] :]

    def most_probable(self, place: _LinearPoint) -> Array:
        """Values (n + k,) by the linear model about a place."""
        metric = Metric(place.problem, self._law)
        residual = place.problem.residual + self._outlying
        columns = place.columns
        precision = metric.gram(columns, columns) + np.eye(columns.shape[1])
        b = metric.gram(columns, residual[:, None])[:, 0]
        coefficients = np.linalg.solve(precision, b)
        fitted = metric.fit(residual - columns @ coefficients)
        return np.concatenate([fitted, coefficients])

    def departure(self, place: _LinearPoint, reached: _LinearPoint) -> float:
        """How far the linear model about a place is off at a point."""
        wrong = (reached.exact - place.linear(reached.values))[:, None]
        energy = self._metric.gram(wrong, wrong).item()
        return float(np.sqrt(max(energy, 0.0)))

    def downhill(self, place: _LinearPoint, reached: _LinearPoint) -> _LinearPoint:
        """The point reached, or one on the way to it that is no less probable."""
        before = self._cost(place)
        for _ in range(HALVINGS):
            if self._cost(reached) <= before:
                break
            reached = self.at(0.5 * (place.values + reached.values))
        return reached

    def _cost(self, place: _LinearPoint) -> float:
        """Squared residuals and values, in units of the noise and of the prior."""
        y = self._problem.in_noise_units(self._problem.y)
        white = self._metric.whiten(y + self._outlying - place.exact)
        return float(white @ white + place.values @ place.values)
