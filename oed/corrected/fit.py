"""Estimates parameters and effects together, under the estimated noise law."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed.base import Array
from oed.corrected.estimate import SEPARATOR, CorrectedEstimate
from oed.corrected.forms import (
    ChosenForm,
    choose_forms,
    groups_by_effect,
    updated_sizes,
)
from oed.effect_model import Effect
from oed.estimation import Estimate, identify
from oed.gap import DOWN, GapProblem, assemble, exact_readings, settle
from oed.instrument import TakenReadings
from oed.measurement import Measurement, Series
from oed.model import Parameter

if TYPE_CHECKING:
    import pandas as pd


class MeasurementWithEffects(Measurement):
    """A measurement of fixed series with coefficients beta (k,) at the end of theta.

    base     the measurement without effects; its compiled functions are shared
    series   all readings, in their order
    names    (k,) of the coefficients, `effect: coefficient`
    sizes    (k,) prior standard deviations of beta
    columns  (N, k) G, SI
    offset   (N,) c, SI
    """

    def __init__(
        self,
        base: Measurement,
        series: Sequence[Series],
        names: Sequence[str],
        sizes: Array,
        columns: Array,
        offset: Array,
    ) -> None:
        self.__dict__.update(base.__dict__)
        coefficients = [
            Parameter(name, 0.0, float(size), "1")
            for name, size in zip(names, sizes, strict=True)
        ]
        self.parameters = (*base.parameters, *coefficients)
        self._size = len(base.parameters)
        self._lengths = np.sqrt(np.mean(columns**2, axis=0)) * sizes
        self._series = tuple(series)
        self._columns, self._offset = {}, {}
        start = 0
        for s in self._series:
            stop = start + len(s) * len(base.setups[s.setup].sigma)
            self._columns[id(s.q)] = columns[start:stop]
            self._offset[id(s.q)] = offset[start:stop]
            start = stop

    @property
    def length_factors(self) -> Array:
        """Factor (n,) that makes each entry a length, m; a coefficient's rms."""
        machine_and_setups = super().length_factors[: self._size]
        return np.concatenate([machine_and_setups, self._lengths])

    def _read_at(self, series: Series, x: Array, theta: Array) -> Array:
        """Readings (m, N of the series) at poses x (m, poses, nx) and theta (m, n)."""
        y = super()._read_at(series, x, theta)
        change = theta[:, self._size :] @ self._columns[id(series.q)].T
        return y + change + self._offset[id(series.q)]

    def _jacobian(self, series: Series, theta: Array) -> Array:
        rows = super()._jacobian(series, theta)
        rows[..., self._size :] = self._columns[id(series.q)]
        return rows

    def taken_measurement(
        self, taken: Sequence[TakenReadings]
    ) -> MeasurementWithEffects:
        """The measurement of series that have some readings of its own."""
        measurement = copy.copy(self)
        measurement._series = tuple(some.part for some in taken)
        measurement._columns, measurement._offset = {}, {}
        for some in taken:
            whole, part = id(some.whole.q), id(some.part.q)
            channels = np.arange(len(self.setups[some.whole.setup].sigma))
            values = (some.rows[:, None] * len(channels) + channels).ravel()
            measurement._columns[part] = self._columns[whole][values]
            measurement._offset[part] = self._offset[whole][values]
        return measurement


MAX_ROUNDS = 6  #: rounds of estimation, linearisation and sizes
#: change of values that ends them, in standard deviations: laws of the noise that are drawn
#: move them by a few hundredths
VALUE_TOLERANCE = 0.1
LOG_SIZE_TOLERANCE = 0.1  #: change of the logarithms of sizes that ends them
MAX_PASSES = 2  #: choices of forms and settled points about each other
#: departure from the linear model, in units of the noise over all readings, up to which it
#: serves
MAX_DEPARTURE = 1.0


@dataclasses.dataclass(frozen=True)
class EffectReadings:
    """Readings y (N,), SI, with the covariates that effects are functions of."""

    measurement: Measurement
    series: tuple[Series, ...]
    y: Array
    covariates: pd.DataFrame  #: one row a reading of the series, as in a Dataset
    gravity: tuple[float, float, float] = DOWN  #: its direction in the base frame

    def problem(self, theta: Array) -> GapProblem:
        """Residuals and states at theta (n,)."""
        return assemble(
            self.measurement,
            self.series,
            self.covariates,
            theta,
            self.y,
            gravity=self.gravity,
        )

    def estimate(
        self,
        effects: Sequence[Effect],
        theta: Array,
        *,
        stages: Sequence[Sequence[str]] = (("*",),),
        estimate_noise: bool = True,
        max_iterations: int = 100,
    ) -> CorrectedEstimate | None:
        """Estimate parameters and effects together, starting at theta (n,), SI.

        None where no effect changes a reading. Raises IdentificationError.
        """
        fit = _JointFit(self, estimate_noise, max_iterations)
        start = fit.start(theta, effects)
        if not start.forms:
            return None
        patterns = [["*"]] if start.settled else [*stages[:-1], ["*"]]
        corrected = fit.settle(start, patterns)
        clean = corrected.estimate.robust_readings
        if clean is None:
            return corrected
        # Few readings far off inflate the noise level, next to which forms are chosen.
        cleaned = _JointFit(
            dataclasses.replace(self, y=clean), estimate_noise, max_iterations
        )
        theta = corrected.estimate.theta[: corrected.parameters]
        again = cleaned.start(theta, effects)
        if not again.forms or _same_constants(start.forms, again.forms):
            return corrected
        return fit.settle(again, [["*"]])


@dataclasses.dataclass(frozen=True)
class _Start:
    """Where a joint fit begins."""

    forms: tuple[ChosenForm, ...]  #: of the effects
    theta: Array  #: (n,) parameters, SI
    beta: Array  #: (k,) coefficients of all forms, in expected sizes
    #: whether that is where the forms explain the readings best, as it is where the
    #: effects are too large for the linear model about the fit without them
    settled: bool


@dataclasses.dataclass(frozen=True)
class _JointFit:
    """How parameters and effects are estimated together."""

    readings: EffectReadings
    estimate_noise: bool
    max_iterations: int

    def start(self, theta: Array, effects: Sequence[Effect]) -> _Start:
        """Forms, chosen about (n,), then anew where they explain the readings best."""
        problem = self.readings.problem(theta)
        forms = choose_forms(problem, effects)
        if not forms:
            return _Start((), theta, np.zeros(0), False)
        for _ in range(MAX_PASSES):
            law = problem.stated_law
            settled = settle(problem, forms, law, np.zeros(len(problem)))
            if not MAX_DEPARTURE < settled.departure < np.inf:
                return _Start(forms, theta, np.zeros_like(settled.coefficients), False)
            before, forms = forms, choose_forms(settled.problem, effects)
            if _same_forms(before, forms):
                break
        return _Start(before, settled.problem.theta, settled.coefficients, True)

    def settle(
        self, start: _Start, patterns: Sequence[Sequence[str]]
    ) -> CorrectedEstimate:
        """Estimate, linearise and find the sizes of the effects in turn."""
        forms, theta, beta = start.forms, start.theta, start.beta
        groups = groups_by_effect(forms)
        parts = [np.full(len(f.names), f.size) for f in forms]
        sizes = np.maximum(np.concatenate(parts), 1.0)
        near: Estimate | None = None
        for _ in range(MAX_ROUNDS):
            problem = self.readings.problem(theta)
            measurement = _linearised(self.readings, problem, forms, sizes, beta)
            estimate = identify(
                measurement,
                problem.series,
                self.readings.y,
                stages=patterns,
                estimate_noise=self.estimate_noise,
                start=np.concatenate([theta, beta]) if start.settled else None,
                near=near,
                max_iterations=self.max_iterations,
            )
            patterns = [["*"]]
            near = estimate
            moved = np.abs(estimate.theta - np.concatenate([theta, beta]))
            theta, beta = np.split(estimate.theta, [len(theta)])
            before = sizes
            of_effects = estimate.covariance[len(theta) :, len(theta) :]
            sizes = updated_sizes(groups, sizes, beta, of_effects)
            still = np.all(np.abs(np.log(sizes / before)) <= LOG_SIZE_TOLERANCE)
            if still and np.all(
                moved <= VALUE_TOLERANCE * np.maximum(estimate.sd, 1e-12)
            ):
                break
        return CorrectedEstimate(
            readings=self.readings,
            measurement=measurement,
            series=problem.series,
            estimate=estimate,
            forms=tuple(forms),
            scales=np.concatenate([f.signature.scales for f in forms]),
            states=problem.states,
        )


def _same_forms(one: Sequence[ChosenForm], other: Sequence[ChosenForm]) -> bool:
    """Whether two choices agree in effects, constants, coefficients and sizes."""
    choices = [[(f.size, f.names) for f in forms] for forms in (one, other)]
    return _same_constants(one, other) and choices[0] == choices[1]


def _same_constants(one: Sequence[ChosenForm], other: Sequence[ChosenForm]) -> bool:
    """Whether two choices agree in effects and constants."""
    return [(f.effect.name, f.constants) for f in one] == [
        (f.effect.name, f.constants) for f in other
    ]


def _linearised(
    readings: EffectReadings,
    problem: GapProblem,
    forms: Sequence[ChosenForm],
    sizes: Array,
    beta: Array,
) -> MeasurementWithEffects:
    """The measurement with effects, exact at the problem's theta and beta (k,)."""
    base, theta = readings.measurement, problem.theta
    columns, names, acting = [], [], []
    start = 0
    for form in forms:
        signature = problem.signature(form.effect, form.constants)
        columns.append(signature.columns_of(form.names))
        names += [f"{form.effect.name}{SEPARATOR}{name}" for name in form.names]
        values = beta[start : start + len(form.names)]
        factors = dict(zip(form.names, values.tolist(), strict=True))
        acting.append((form.effect, form.constants, factors))
        start += len(form.names)
    gradients = np.hstack(columns)
    exact = exact_readings(base, problem.series, theta, problem.states, acting)
    offset = exact - base.readings(problem.series, theta) - gradients @ beta
    return MeasurementWithEffects(base, problem.series, names, sizes, gradients, offset)
