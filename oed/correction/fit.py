"""Estimates parameters and effects together, under the estimated noise law."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import identification
from oed.arrays import Array
from oed.correction.effect_measurement import SEPARATOR, MeasurementWithEffects
from oed.correction.forms import ChosenForm, choose_forms
from oed.effect import Effect, State
from oed.estimate import Estimate
from oed.gap.data import problem as problems
from oed.gap.data import signature as signatures
from oed.gap.data.state import DOWN
from oed.measurement import Measurement, Series

if TYPE_CHECKING:
    import pandas as pd

#: rounds of estimation and linearisation, and relative change that ends them
ROUNDS, SETTLED = 4, 0.02


@dataclasses.dataclass(frozen=True)
class EffectReadings:
    """Readings y (N,), SI, with the covariates that effects are functions of.

    covariates  one row a reading of the series, as in a Dataset
    gravity     its direction in the base frame
    """

    measurement: Measurement
    series: tuple[Series, ...]
    y: Array
    covariates: pd.DataFrame
    gravity: tuple[float, float, float] = DOWN

    def problem(self, theta: Array) -> problems.GapProblem:
        """Residuals and states at theta (n,)."""
        return problems.assemble(
            self.measurement,
            self.series,
            self.covariates,
            theta,
            self.y,
            gravity=self.gravity,
        )


@dataclasses.dataclass(frozen=True)
class CorrectedEstimate:
    """Parameters and effects, estimated together.

    readings     what was fitted
    measurement  with the effects' coefficients at the end of theta
    series       the readings' series, each reading with its pose
    estimate     of theta = [parameters, coefficients]; a coefficient is in prior
                 standard deviations of its effect
    forms        of the effects, with their constants
    scales       (k,) prior standard deviations of the coefficients, in their own units
    states       of the machine, one a series
    """

    readings: EffectReadings
    measurement: MeasurementWithEffects
    series: tuple[Series, ...]
    estimate: Estimate
    forms: tuple[ChosenForm, ...]
    scales: Array
    states: tuple[State, ...]

    @property
    def parameters(self) -> int:
        """Number of leading entries of theta that are not coefficients."""
        return len(self.estimate.theta) - len(self.scales)

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names (k,) of the coefficients, `effect: coefficient`."""
        return self.measurement.names[self.parameters :]

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients by name, in prior standard deviations of their effect."""
        values = self.estimate.theta[self.parameters :].tolist()
        return dict(zip(self.coefficient_names, values, strict=True))


def estimate_with_effects(
    readings: EffectReadings,
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
    forms = choose_forms(readings.problem(theta), effects)
    if not forms:
        return None
    patterns = [list(p) for p in stages[:-1]] + [["*"]]
    fit = _JointFit(readings, estimate_noise, max_iterations)
    corrected = fit.settle(forms, theta, {}, patterns)
    clean = corrected.estimate.robust_readings
    if clean is None:
        return corrected
    # Few readings far off inflate the noise level, and sizes look too small next to it.
    theta = corrected.estimate.theta[: corrected.parameters]
    cleaned = dataclasses.replace(readings, y=clean)
    again = choose_forms(cleaned.problem(theta), effects)
    if not again or _same_forms(forms, again):
        return corrected
    return fit.settle(again, theta, corrected.coefficients, [["*"]])


@dataclasses.dataclass(frozen=True)
class _JointFit:
    """How parameters and effects are estimated together."""

    readings: EffectReadings
    estimate_noise: bool
    max_iterations: int

    def settle(
        self,
        forms: Sequence[ChosenForm],
        theta: Array,
        coefficients: Mapping[str, float],
        patterns: Sequence[Sequence[str]],
    ) -> CorrectedEstimate:
        """Estimate and linearise in turn, from theta (n,) and coefficients by name."""
        names = [n for form in forms for n in _coefficient_names(form)]
        beta = np.array([coefficients.get(name, 0.0) for name in names])
        sizes = np.concatenate([np.full(len(f.signature.names), f.size) for f in forms])
        for _ in range(ROUNDS):
            problem = self.readings.problem(theta)
            measurement = _linearised(self.readings, problem, forms, sizes, beta)
            estimate = identification.identify(
                measurement,
                problem.series,
                self.readings.y,
                stages=patterns,
                estimate_noise=self.estimate_noise,
                max_iterations=self.max_iterations,
            )
            patterns = [["*"]]
            moved = np.abs(estimate.theta - np.concatenate([theta, beta]))
            theta, beta = np.split(estimate.theta, [len(theta)])
            if np.all(moved <= SETTLED * np.maximum(estimate.sd, 1e-12)):
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


def _coefficient_names(form: ChosenForm) -> list[str]:
    return [f"{form.effect.name}{SEPARATOR}{name}" for name in form.signature.names]


def _same_forms(one: Sequence[ChosenForm], other: Sequence[ChosenForm]) -> bool:
    """Whether two choices agree in effects, constants and sizes."""
    return [(f.effect.name, f.constants, f.size) for f in one] == [
        (f.effect.name, f.constants, f.size) for f in other
    ]


def _linearised(
    readings: EffectReadings,
    problem: problems.GapProblem,
    forms: Sequence[ChosenForm],
    sizes: Array,
    beta: Array,
) -> MeasurementWithEffects:
    """The measurement with effects, exact at the problem's theta and beta (k,)."""
    base, theta = readings.measurement, problem.theta
    columns, names, acting = [], [], []
    start = 0
    for form in forms:
        wanted = form.signature.names
        signature = problem.signature(form.effect, form.constants)
        place = {name: k for k, name in enumerate(signature.names)}
        table = np.zeros((len(problem), len(wanted)))
        for k, name in enumerate(wanted):
            if name in place:
                table[:, k] = signature.columns[:, place[name]]
        columns.append(table)
        names += _coefficient_names(form)
        values = beta[start : start + len(wanted)]
        factors = dict(zip(wanted, values.tolist(), strict=True))
        acting.append((form.effect, form.constants, factors))
        start += len(wanted)
    slopes = np.hstack(columns)
    exact = signatures.exact_readings(
        base, problem.series, theta, problem.states, acting
    )
    offset = exact - base.readings(problem.series, theta) - slopes @ beta
    return MeasurementWithEffects(base, problem.series, names, sizes, slopes, offset)
