"""Effects that a study allows beside the geometry: their columns, and what was found."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.checks.goodness import Goodness
from oed.compensate.effects.effect_maps import SessionStates
from oed.compensate.effects.expected_columns import ExpectedColumns, expected_columns
from oed.compensate.effects.fit import EffectReadings
from oed.estimation.estimate import Estimate
from oed.estimation.left_out import left_out_errors
from oed.gap.data import problem as problems
from oed.gap.data.problem import GapProblem
from oed.measurement.measurement import Measurement, Series
from oed.model.machine import Machine
from oed.noise.prior import KNOWN_TO
from oed.result import (
    CorrectedSection,
    EffectSizeRecord,
    EstimateSection,
    GoodnessSection,
    MixtureSection,
    trust,
)
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.resolve.planned_effects import named_effects
from pkm_studies.resolve.prediction import check_states
from pkm_studies.stages.corrected import alarm
from pkm_studies.stages.fit.states import recorded_states
from pkm_studies.stages.gap.virtual_readings import covariates_of
from pkm_studies.stages.run_state import Fitted, Measured

if TYPE_CHECKING:
    import pandas as pd

Section = TypeVar("Section", EstimateSection, CorrectedSection, MixtureSection)

#: mean square of readings left out, over that of the fit without effects, up to which
#: effects explain the misfit
PREDICTED = 0.25
#: numbers from which a fit cannot follow single readings
MOST_LEFT_OUT = 3000
#: ends of a 95 % interval
INTERVAL = (0.025, 0.975)


def expected_effects(state: Measured, plain: Estimate) -> ExpectedColumns | None:
    """What the effects of [identify] do to the readings; None where it allows none.

    plain  the fit without effects. Raises InputError for a name that is no effect of the
           study.
    """
    request = state.resolved.gap_or_default
    names = state.study.identify.fitted_effects
    place = state.study.place.key("identify").key("effects")
    allowed = named_effects(request, names, place)
    given = readings_with_covariates(state, request)
    return expected_columns(given.problem(plain.theta), allowed)


def _predicts(state: Measured, without: Goodness | None, estimate: Estimate) -> bool:
    """Whether effects predict readings from others, and do not only follow them.

    The misfit of readings left out is at most a share of that of the fit without effects.
    """
    series = state.readings.series
    if without is None or len(estimate.residuals) > MOST_LEFT_OUT:
        return True
    errors = left_out_errors(state.measurement, series, estimate)
    mean_square = float(np.mean((errors / state.measurement.sigma(series)) ** 2))
    return mean_square <= PREDICTED * without.chi2 / len(errors)


def _is_good(estimate: Estimate) -> bool:
    """Whether the residuals are as large as noise that is known to a factor only."""
    return not trust.chi2_is_large(estimate.chi2 / KNOWN_TO**2, estimate.dof)


def readings_with_covariates(state: Measured, request: GapRequest) -> EffectReadings:
    """The readings with what effects are functions of."""
    readings, measurement = state.readings, state.measurement
    covariates = covariates_of(
        measurement, readings.series, readings.covariates, request
    )
    series = tuple(readings.series)
    return EffectReadings(measurement, series, readings.y, covariates, request.gravity)


def session_states(state: Fitted) -> SessionStates:
    """States in which the readings were taken."""
    return SessionStates.of(_problem(state))


def states_in_use(state: Fitted) -> SessionStates:
    """States in which the machine is used: those of [prediction], else those recorded.

    Raises InputError for a covariate that no reading has.
    """
    problem, resolved = _problem(state), state.resolved
    used = {} if resolved.prediction is None else resolved.prediction.states
    if not used:
        used = recorded_states(state.readings.covariates)
    check_states(state.study, problem.covariates)
    return SessionStates.of(problem, used)


def _problem(state: Fitted) -> GapProblem:
    request = state.resolved.gap_or_default
    return readings_with_covariates(state, request).problem(state.estimate.theta)


def changes_by_effects(
    state: Fitted, series: Sequence[Series], covariates: pd.DataFrame, draws: Array
) -> Array | None:
    """Changes (m, N) of other readings of the session by drawn effects (m, k), SI.

    None where the study allows no effects.
    """
    columns = state.effect_columns
    if columns is None:
        return None
    gravity = state.resolved.gap_or_default.gravity
    problem = problems.assemble(
        state.measurement, series, covariates, state.estimate.theta, gravity=gravity
    )
    return np.asarray(draws @ columns.changes(problem, session_states(state)).T)


def with_effects(
    section: EstimateSection,
    estimate: Estimate,
    columns: ExpectedColumns,
    measurement: Measurement,
    series: Sequence[Series],
) -> EstimateSection:
    """The section with the effects that the fit drew, the largest change first."""
    sampled = estimate.effects
    if sampled is None:
        return section
    discrepancy = columns.discrepancy
    white = discrepancy.columns / measurement.sigma(series)[:, None]
    records = []
    for g, members in enumerate(discrepancy.members()):
        low, high = np.quantile(sampled.sizes[:, g], INTERVAL)
        change = white[:, members] @ sampled.coefficients[:, members].T
        records.append(
            EffectSizeRecord(
                name=discrepancy.names[g],
                size=float(sampled.rms_sizes[g]),
                low=float(low),
                high=float(high),
                change=float(np.sqrt((change**2).mean())),
                unknown=bool(discrepancy.unknown[g]),
            )
        )
    records.sort(key=lambda record: -record.change)
    return msgspec.structs.replace(section, effects=records, faulty=sampled.faulty)


def with_controller(section: Section, machine: Machine, sent: Array) -> Section:
    """The section with the parameters (np,) that the controller is given, SI."""
    controller = {}
    for parameter, value in zip(machine.parameters, sent, strict=True):
        estimate = section.parameters.get(parameter.name)
        if estimate is not None:
            controller[parameter.name] = units.number(float(value), estimate.unit)
    return msgspec.structs.replace(section, controller=controller)


def judged_with_effects(
    state: Measured, section: GoodnessSection, estimate: Estimate
) -> tuple[Measured, GoodnessSection]:
    """The state and its goodness where the alarms of the check are true with effects.

    The check looked at a fit without effects. Where the fit with them is good, its alarms
    become remarks.
    """
    checked = state.checked
    if checked is None or not checked.bad_fit:
        return state, section
    ratio = trust.noise_ratio(estimate.chi2, estimate.dof)
    without = checked.goodness
    resolved_by_effects = _is_good(estimate) and _predicts(state, without, estimate)
    if not (resolved_by_effects and alarm.may_be_resolved(checked.findings)):
        return state, section
    opening = alarm.allowed_effects_sentence(ratio)
    true = alarm.sentences_with(opening, checked.findings)
    remaining = tuple(f for f in checked.findings if not alarm.is_about_the_fit(f))
    resolved = state.replace(
        checked=dataclasses.replace(checked, findings=remaining),
        warnings=tuple(true.get(w, w) for w in state.warnings),
    )
    sentences = [true.get(sentence, sentence) for sentence in section.findings]
    return resolved, msgspec.structs.replace(section, findings=sentences, bad_fit=False)
