"""Readings with what effects are functions of, states in which they act, what is sent."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from oed import units
from oed.base import Array
from oed.corrected import EffectReadings
from oed.effects import SessionStates
from oed.gap import GapProblem
from oed.model import Machine
from oed.result import CorrectedSection, MixtureSection
from pkm_studies.resolve import GapRequest, check_states
from pkm_studies.stages.fit.states import recorded_states
from pkm_studies.stages.gap.virtual_readings import covariates_of
from pkm_studies.stages.run_state import Fitted, Measured

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
