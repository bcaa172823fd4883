"""Steps that predict: accuracy over the workspace, and held-out readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import msgspec
import numpy as np

from oed.accuracy.budget import budget_model, budget_of
from oed.accuracy.maps import ErrorMaps, Reference
from oed.accuracy.prediction import Spread, least_error
from oed.base.arrays import Array
from oed.base.units import MM
from oed.compensate.effects.effect_maps import SessionStates
from oed.compensate.effects.unmodelled import ExpectedEffects, expected_effects
from oed.gap.data import problem as problems
from oed.measurement.measurement import Measurement, Series
from oed.posterior import laplace
from oed.posterior.laplace import ApproximateDraws
from oed.result import PredictionSection, SpreadRecord, ToolAccuracy, trust
from oed.result.mixture import BEST, MIXTURE, NOTHING, PLAIN
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.stages.fit.effects import (
    changes_by_effects,
    states_in_use,
    with_controller,
)
from pkm_studies.stages.fit.states import displayed_states
from pkm_studies.stages.gap.virtual_readings import empty_readings
from pkm_studies.stages.predict import accuracy, knowledge
from pkm_studies.stages.predict.budget import budget_section
from pkm_studies.stages.predict.held_out import held_out_sections
from pkm_studies.stages.predict.knowledge import (
    Accuracy,
    ActingEffects,
    ParameterKnowledge,
)
from pkm_studies.stages.predict.virtual_machines import realised_accuracy
from pkm_studies.stages.run_state import (
    Fitted,
    Measured,
    Scheduled,
    ScheduledT,
    Stream,
)
from pkm_studies.study.tables import PredictionTable


def predict_accuracy(state: ScheduledT) -> ScheduledT:
    """Predict the residual accuracy over the workspace, and check it on machines.

    With readings of a virtual machine, which only exercise the plan, the prediction
    rests on the tolerances alone.
    """
    request = state.resolved.prediction
    if request is None:
        return state
    table, command = request.table, request.command
    if _is_untrusted(state):
        reason = _withheld(state)
        return state.with_warnings(reason).without_section("prediction", reason)
    state.progress.stage("prediction")
    realised = _realised(state, table, command)
    rng = state.rng(Stream.PREDICT)
    candidates = _candidates(state, command, table.reference, rng)
    judged = knowledge.compared(candidates, command, table.reference, rng)
    predicted = {name: result.prediction for name, result in judged.items()}
    shown = sent = BEST
    if len(candidates) > 1:
        after = {name: p.after for name, p in predicted.items()}
        driven = state.measurement.machine.driven
        sent = least_error(predicted[BEST].before, after, driven)
        shown = BEST if sent == NOTHING else sent
    known, main = candidates[shown], judged[shown]
    section = _section(state, known, main)
    section = msgspec.structs.replace(
        section,
        references=_references(state, known, main),
        tools=_tools(state, table, known, command),
        **_states(known, table),
    )
    section = accuracy.with_wanted(section, state.resolved.wanted_accuracy)
    if isinstance(state, Fitted) and len(candidates) > 1:
        estimate = msgspec.structs.replace(state.estimate_section, sent=sent)
        if known.sent is not None:
            machine = state.measurement.machine
            estimate = with_controller(estimate, machine, known.sent)
        state = state.with_sections(estimate=estimate)
    return state.with_sections(prediction=accuracy.with_realised(section, realised))


def _candidates(
    state: Scheduled, command: Array, reference: Reference, rng: np.random.Generator
) -> dict[str, ParameterKnowledge]:
    """What a controller may be sent; beside the identified parameters where effects act.

    Those that take up what is known of the effects, and those of a fit without effects.
    """
    known = _knowledge(state)
    absorbed = knowledge.with_absorbed_effects(known, command, reference, rng)
    if not isinstance(state, Fitted) or absorbed.sent is None:
        return {BEST: known}
    count = len(state.measurement.machine.parameters)
    plain = dataclasses.replace(known, sent=state.plain.theta[:count])
    return {BEST: known, MIXTURE: absorbed, PLAIN: plain}


def _states(known: ParameterKnowledge, table: PredictionTable) -> dict[str, Any]:
    """Fields of the section: the states in which effects act."""
    used = {} if known.effects is None else known.effects.session.used
    if not used:
        return {}
    source = "study" if table.states else "readings"
    return {"states": displayed_states(used), "states_from": source}


def _realised(
    state: Scheduled, table: PredictionTable, command: Array
) -> Mapping[str, Spread] | None:
    """Accuracy of virtual machines; None where the study asks for none."""
    return realised_accuracy(
        state.measurement,
        state.readings.series,
        command,
        table.reference,
        table.virtual_machines,
        state.rng(Stream.MACHINES),
        stages=state.resolved.identification_stages,
        progress=state.progress.share,
    )


def _knowledge(state: Scheduled) -> ParameterKnowledge:
    """What the prediction rests on: real readings, or the plan."""
    series = state.readings.series
    if not isinstance(state, Fitted) or state.readings.truth is not None:
        return knowledge.planned(state.measurement, series)
    draws = _draws(state)
    return knowledge.identified(
        state.measurement, series, state.estimate, draws, _acting_effects(state, draws)
    )


def _acting_effects(state: Fitted, draws: ApproximateDraws) -> ActingEffects | None:
    """Effects of the fit, in the states of use; None without effects."""
    columns = state.effect_columns
    if columns is None:
        return None
    return ActingEffects(
        columns=columns,
        session=states_in_use(state),
        theta=state.estimate.theta,
        draws=draws.effects,
    )


def _draws(state: Fitted) -> ApproximateDraws:
    """Draws of parameters and noise law: of the posterior, or of its approximation.

    Both follow directions that no reading determines; a covariance does not.
    """
    sampled = state.posterior
    if sampled is not None:
        theta, laws = sampled.pooled, sampled.noise_law
        laws = laws.reshape(len(theta), laws.shape[2])
        return ApproximateDraws(theta, laws, float(np.nanmin(sampled.ess)))
    return laplace.draw_approximation(
        state.measurement,
        state.readings.series,
        state.readings.y,
        state.estimate,
        state.rng(Stream.LAPLACE),
    )


def _section(
    state: Scheduled, known: ParameterKnowledge, main: Accuracy
) -> PredictionSection:
    """The section with its budget."""
    machine, planned = state.measurement.machine, known.mean is None
    budget = budget_of(
        known.model,
        main.maps,
        estimated=known.estimated,
        predicted=main.variance,
        unmodelled=main.unmodelled,
    )
    mode = "plan" if planned else "identified"
    section = accuracy.accuracy_section(
        state.measurement.kinematics, main.prediction, mode, budget
    )
    expected = _expected_effects(state, main) if planned else None
    lines = budget_section(machine, main.prediction, budget, expected)
    return msgspec.structs.replace(section, budget=lines)


def _expected_effects(state: Scheduled, main: Accuracy) -> ExpectedEffects | None:
    """Effects that usually go unmodelled, at the sizes that are expected of them."""
    return expected_unmodelled(
        state.measurement,
        state.readings.series,
        main.maps,
        state.resolved.gap_or_default,
        main.prediction.reference,
        state.rng(Stream.UNMODELLED),
    )


def _references(
    state: Scheduled, known: ParameterKnowledge, main: Accuracy
) -> dict[str, dict[str, SpreadRecord]]:
    """Accuracy after compensation against each reference."""
    machine, predicted = state.measurement.machine, main.prediction
    others = [r for r in get_args(Reference) if r != predicted.reference]
    rng = state.rng(Stream.REFERENCES)
    further = knowledge.accuracy(known, predicted.command, others, rng)
    records: dict[str, dict[str, SpreadRecord]] = {}
    records[predicted.reference] = accuracy.after_records(machine, predicted)
    for reference, result in further.items():
        records[reference] = accuracy.after_records(machine, result.prediction)
    return records


def _tools(
    state: Scheduled,
    table: PredictionTable,
    known: ParameterKnowledge,
    command: Array,
) -> list[ToolAccuracy]:
    """Accuracy after compensation at tools of the lengths that the study names."""
    machine = state.measurement.machine
    rng = state.rng(Stream.TOOLS)
    records = []
    for length in table.tools:
        tool = np.array([0.0, 0.0, length * MM])
        moved = machine.with_tool(command, tool)
        result = knowledge.accuracy(known, moved, [table.reference], rng, tool)
        predicted = result[table.reference].prediction
        records.append(accuracy.tool_accuracy(machine, predicted, length * MM))
    return records


def _is_untrusted(state: Scheduled) -> bool:
    """Whether a prediction would rest on a fit that is not to be trusted.

    With readings of a virtual machine it rests on none.
    """
    if not isinstance(state, Measured) or state.readings.truth is not None:
        return False
    result = state.result
    fitted = trust.section_objections(result.goodness, result.estimate)
    return state.fit_is_bad or bool(fitted)


def _withheld(state: Scheduled) -> str:
    """Why no accuracy is predicted from the fit without effects."""
    if not isinstance(state, Fitted) or state.corrected is None:
        return "The predicted accuracy is withheld: it would rest on a bad fit"
    return "The fit without effects is bad: no accuracy is predicted from it"


def predict_held_out(state: Fitted) -> Fitted:
    """Compare held-out readings with what posterior or approximation predicts."""
    held_out = state.readings.held_out
    if held_out is None:
        return state
    state.progress.stage("held-out readings")
    draws = _draws(state)
    changes = changes_by_effects(
        state, held_out.series, held_out.covariates, draws.effects
    )
    sections = held_out_sections(
        state.measurement,
        held_out.series,
        held_out.y,
        state.estimate,
        draws,
        state.rng(Stream.HELD_OUT),
        changes,
    )
    return state.with_sections(held_out=sections)


# -- effects that no plan models -------------------------------------------------------


def expected_unmodelled(
    measurement: Measurement,
    series: Sequence[Series],
    maps: ErrorMaps,
    request: GapRequest,
    reference: Reference,
    rng: np.random.Generator,
) -> ExpectedEffects | None:
    """Errors by each effect of a request in planned readings and over the workspace."""
    planned = empty_readings(measurement, series, request)
    problem = problems.assemble(
        measurement, planned.series, planned.covariates, gravity=request.gravity
    )
    model = budget_model(measurement, problem.series, measurement.nominal)
    return expected_effects(
        problem, SessionStates.of(problem), model, maps, request.effects, reference, rng
    )
