"""Readings with what effects are functions of, states in which they act, what is sent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.corrected import EffectReadings
from oed.dataset import ReadingsColumn, temperature_body
from oed.effects import SessionStates
from oed.gap import GapProblem
from oed.model import Machine
from oed.result import CorrectedSection, MixtureSection
from pkm_studies.resolve import GapRequest, check_states
from pkm_studies.stages.gap.virtual_readings import covariates_of
from pkm_studies.stages.run_state import Fitted, Measured

if TYPE_CHECKING:
    import pandas as pd

# States in which a machine is used: as the study states them, else as recorded.

#: beginnings of the names of a machine's own bodies; a bar is none
OWN_BODIES = ("leg", "frame")
#: covariates of which every recorded value is one of use
VALUES = ("direction", "payload")


def recorded_states(covariates: pd.DataFrame | None) -> dict[str, Array]:
    """States of use that readings recorded, by covariate, SI.

    Both directions and all payloads, where several were recorded, and each body of the
    machine as cold and as warm as it was. Empty where nothing is recorded.
    """
    if covariates is None:
        return {}
    states = {}
    for name in map(str, covariates.columns):
        body = temperature_body(name)
        warms = body is not None and body.startswith(OWN_BODIES)
        if not warms and name not in VALUES:
            continue
        values = np.unique(covariates[name].dropna().to_numpy(dtype=float))
        if len(values) > 1:
            states[name] = values[[0, -1]] if warms else values
    return states


def extrapolated_states(
    used: Mapping[str, Array], covariates: pd.DataFrame
) -> list[str]:
    """Sentences on values in use, SI, that lie outside what the readings recorded."""
    sentences = []
    for name, values in used.items():
        if name not in covariates:
            continue
        ends = np.array([covariates[name].min(), covariates[name].max()])
        if not ((values < ends[0]) | (values > ends[1])).any():
            continue
        ((column, shown),) = displayed_states({name: values}).items()
        low, high = displayed_states({name: ends})[column]
        sentences.append(
            f"the prediction is for {column} {' and '.join(f'{v:g}' for v in shown)},"
            f" beyond the readings ({low:g} to {high:g}): what effects do there is"
            " extrapolated"
        )
    return sentences


def displayed_states(states: Mapping[str, Array]) -> dict[str, list[float]]:
    """States by column of the readings file, in its unit."""
    shown = {}
    for name, values in states.items():
        column = ReadingsColumn.of_covariate(name)
        if column is not None:
            shown[column.name] = [float(value) / column.factor for value in values]
    return shown


Section = TypeVar("Section", CorrectedSection, MixtureSection)


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


def add_controller(section: Section, machine: Machine, sent: Array) -> Section:
    """The section with the parameters (np,) that the controller is given, SI."""
    controller = {}
    for parameter, value in zip(machine.parameters, sent, strict=True):
        estimate = section.parameters.get(parameter.name)
        if estimate is not None:
            controller[parameter.name] = units.number(float(value), estimate.unit)
    return msgspec.structs.replace(section, controller=controller)
