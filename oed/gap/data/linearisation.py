"""Residuals about a point at which effects act: exact there, linear around it.

Readings y(theta, beta) of a machine with effects are, about (theta_1, beta_1),

    y = y(theta_1, beta_1) + H (theta - theta_1) + G (beta - beta_1) + e,

so that the residuals of `oed.gap.data.problem` about theta_1 lose what G beta_1 lacks of
the exact change. Effects of micrometres are linear; a leg that goes 6 % too far is not.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.base import Array
from oed.effect_model import Effect
from oed.gap.data.problem import GapProblem, Metric, exact_readings
from oed.mechanism import AssemblyError
from oed.noise import NoiseLaw


@dataclasses.dataclass(frozen=True)
class ActingEffectForm:
    """A form of an effect that acts."""

    effect: Effect  #: the effect
    constants: Mapping[str, float]  #: {constant: value}
    names: tuple[str, ...]  #: (k,) of the coefficients that may differ from 0
    size: float  #: prior standard deviation of these, in expected sizes


@dataclasses.dataclass(frozen=True)
class Settled:
    """Readings linearised where some forms explain them best."""

    problem: GapProblem  #: with its residuals there
    coefficients: Array  #: of all forms there, one after the other, in expected sizes
    #: how far the linear model of the beginning is off where it leads: norm over all
    #: readings, in units of the noise, of what parameters leave
    departure: float


def settle(
    problem: GapProblem,
    forms: Sequence[ActingEffectForm],
    law: NoiseLaw,
    outlying: Array,
) -> Settled:
    """The readings linearised where forms explain them best, by Gauss-Newton steps,
    less what `outlying` (N,) gains; else as they were, with a departure of infinity.
    """
    fit = _PointFit(problem, forms, law, outlying)
    point = fit.start()
    departure = None
    try:
        for _ in range(16):
            reached = fit.at(fit.most_probable(point))
            off = fit.departure(point, reached)
            departure = off if departure is None else departure
            point = fit.downhill(point, reached)
            if off < 0.3:
                coefficients = fit.sizes * point.values[fit.parameters :]
                return Settled(point.problem, coefficients, departure)
    except AssemblyError:
        pass
    return Settled(problem, np.zeros(len(fit.sizes)), np.inf)


@dataclasses.dataclass(frozen=True)
class _LinearPoint:
    """A point and the readings linearised about it."""

    #: (n + k,) parameters, then coefficients, in prior standard deviations
    values: Array
    problem: GapProblem  #: with its residuals there
    columns: Array  #: (N, k) of the forms there, per prior sd, in units of the noise
    exact: Array  #: (N,) the readings of the point, in units of the noise

    def change(self, values: Array) -> Array:
        """Change of the readings (N,) by values (n + k,), linear about this point."""
        return np.hstack([self.problem.slopes, self.columns]) @ values


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
        #: number of parameters
        self.parameters = self._root.shape[1]
        #: (k,) prior standard deviations of all coefficients, in expected sizes
        self.sizes = np.repeat([f.size for f in forms], [len(f.names) for f in forms])

    def start(self) -> _LinearPoint:
        """The parameters of the problem without effects, by its own linear model."""
        problem = self._problem
        off_nominal = problem.theta - problem.measurement.nominal
        parameters = np.linalg.lstsq(self._root, off_nominal, rcond=None)[0]
        values = np.concatenate([parameters, np.zeros(len(self.sizes))])
        about = _LinearPoint(values, problem, self._columns(problem), problem.residual)
        exact = problem.noise_units(problem.y) - problem.residual
        return dataclasses.replace(about, exact=exact + about.change(values))

    def _columns(self, problem: GapProblem) -> Array:
        """Columns (N, k) of all forms, per prior sd, in units of the noise."""
        parts = [
            problem.signature(form.effect, form.constants).columns_of(form.names)
            for form in self._forms
        ]
        return problem.noise_units(self.sizes * np.hstack(parts))

    def at(self, values: Array) -> _LinearPoint:
        """The readings linearised about values (n + k,). Raises AssemblyError."""
        problem, split = self._problem, self.parameters
        theta = problem.measurement.nominal + self._root @ values[:split]
        moved = problem.about(theta)
        factors = iter((self.sizes * values[split:]).tolist())
        acting = []
        for form in self._forms:
            of_form = dict(zip(form.names, factors, strict=False))
            acting.append((form.effect, form.constants, of_form))
        exact = moved.noise_units(
            exact_readings(moved.measurement, moved.series, theta, moved.states, acting)
        )
        about = _LinearPoint(values, moved, self._columns(moved), exact)
        residual = moved.noise_units(moved.y) - exact + about.change(values)
        return dataclasses.replace(about, problem=moved.with_residual(residual))

    def most_probable(self, point: _LinearPoint) -> Array:
        """Values (n + k,) by the linear model about a point."""
        metric = Metric(point.problem, self._law)
        residual = point.problem.residual + self._outlying
        coefficients, _ = metric.posterior(point.columns, residual)
        fitted = metric.fit(residual - point.columns @ coefficients)
        return np.concatenate([fitted, coefficients])

    def departure(self, point: _LinearPoint, reached: _LinearPoint) -> float:
        """How far the linear model about a point is off at another."""
        change = point.change(reached.values - point.values)
        wrong = (reached.exact - point.exact - change)[:, None]
        energy = self._metric.gram(wrong, wrong).item()
        return float(np.sqrt(max(energy, 0.0)))

    def downhill(self, point: _LinearPoint, reached: _LinearPoint) -> _LinearPoint:
        """The point reached, or one on the way to it that is no less probable."""
        before = self._cost(point)
        for _ in range(6):
            if self._cost(reached) <= before:
                break
            reached = self.at(0.5 * (point.values + reached.values))
        return reached

    def _cost(self, point: _LinearPoint) -> float:
        """Squared residuals and values, in units of the noise and of the prior."""
        y = self._problem.noise_units(self._problem.y)
        white = self._metric.whiten(y + self._outlying - point.exact)
        return float(white @ white + point.values @ point.values)
