"""Estimates parameters and effects together, under the estimated noise law."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
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
    sizes = np.concatenate([np.full(len(f.signature.names), f.size) for f in forms])
    beta = np.zeros(len(sizes))
    patterns = [list(p) for p in stages[:-1]] + [["*"]]
    for _ in range(ROUNDS):
        problem = readings.problem(theta)
        measurement = _linearised(readings, problem, forms, sizes, beta)
        estimate = identification.identify(
            measurement,
            problem.series,
            readings.y,
            stages=patterns,
            estimate_noise=estimate_noise,
            max_iterations=max_iterations,
        )
        patterns = [["*"]]
        moved = np.abs(estimate.theta - np.concatenate([theta, beta]))
        theta, beta = np.split(estimate.theta, [len(theta)])
        if np.all(moved <= SETTLED * np.maximum(estimate.sd, 1e-12)):
            break
    scales = np.concatenate([f.signature.scales for f in forms])
    return CorrectedEstimate(
        readings, measurement, problem.series, estimate, forms, scales, problem.states
    )


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
        names += [f"{form.effect.name}{SEPARATOR}{name}" for name in wanted]
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
