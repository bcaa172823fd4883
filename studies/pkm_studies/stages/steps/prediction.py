"""Steps that predict: accuracy over the workspace, and held-out readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import get_args

import msgspec
import numpy as np

from oed import posterior, trust
from oed.accuracy import ErrorMaps, Reference, Spread, budget_model
from oed.base import Array
from oed.effects import ExpectedEffects, SessionStates, expected_effects
from oed.gap import assemble
from oed.measurement import Measurement, Series
from oed.posterior import ApproximateDraws
from oed.result import PredictionSection, SpreadRecord, ToolAccuracy
from oed.units import MM
from pkm_studies.base import Stream
from pkm_studies.resolve import GapRequest
from pkm_studies.stages.fit.effects import session_states
from pkm_studies.stages.gap.virtual_readings import empty_readings
from pkm_studies.stages.predict import accuracy, knowledge
from pkm_studies.stages.predict.budget import budget_section
from pkm_studies.stages.predict.held_out import HypothesisDraws, held_out_sections
from pkm_studies.stages.predict.knowledge import Accuracy, ParameterKnowledge
from pkm_studies.stages.predict.virtual_machines import realised_accuracy
from pkm_studies.stages.run_state import (
    Fitted,
    HeldOut,
    Measured,
    Scheduled,
    ScheduledT,
)
from pkm_studies.tables import PredictionTable

#: draws used for predictive intervals
PREDICTIVE_DRAWS = 2000


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
        return state.add_warnings(reason).withhold_section("prediction", reason)
    state.progress.stage("prediction")
    realised = _realised(state, table, command)
    rng = state.rng(Stream.PREDICT)
    known = _knowledge(state)
    main = knowledge.accuracy(known, command, [table.reference], rng)[table.reference]
    section = _section(state, known, main)
    section = msgspec.structs.replace(
        section,
        references=_references(state, known, main),
        tools=_tools(state, table, known, command),
    )
    section = accuracy.add_wanted(section, state.resolved.wanted_accuracy)
    return state.add_sections(prediction=accuracy.add_realised(section, realised))


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
    return knowledge.identified(state.measurement, series, state.estimate, draws)


def _draws(state: Fitted) -> ApproximateDraws:
    """Draws of parameters and noise law: of the posterior, or of its approximation.

    Both follow directions that no reading determines; a covariance does not.
    """
    sampled = state.posterior
    if sampled is not None:
        theta, laws = sampled.pooled, sampled.noise_law
        laws = laws.reshape(len(theta), laws.shape[2])
        return ApproximateDraws(theta, laws, float(np.nanmin(sampled.ess)))
    return posterior.draw_approximation(
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
    budget = known.model.budget(
        main.maps,
        estimated=known.estimated,
        predicted=main.variance,
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
    records[predicted.reference] = accuracy.component_records(machine, predicted)
    for reference, result in further.items():
        records[reference] = accuracy.component_records(machine, result.prediction)
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
    """Compare held-out readings with what the fit predicts, over all answers if any."""
    held_out = state.readings.held_out
    if held_out is None:
        return state
    state.progress.stage("held-out readings")
    rng = state.rng(Stream.HELD_OUT)
    drawn = _hypothesis_draws(state, held_out, rng)
    sections = held_out_sections(
        state.measurement, held_out.series, held_out.y, drawn, rng
    )
    return state.add_sections(held_out=sections)


def _hypothesis_draws(
    state: Fitted, held_out: HeldOut, rng: np.random.Generator
) -> list[HypothesisDraws]:
    """Draws by the fit, or by each answer of the diagnosis in its share."""
    if state.mixture is None:
        draws = _draws(state)
        count = min(PREDICTIVE_DRAWS, len(draws.theta))
        rows = rng.choice(len(draws.theta), size=count, replace=False)
        return [
            HypothesisDraws(state.estimate, draws.theta[rows], draws.noise_law[rows])
        ]
    problem = assemble(
        state.measurement,
        held_out.series,
        held_out.covariates,
        state.estimate.theta,
        gravity=state.resolved.gap_or_default.gravity,
    )
    session = session_states(state)
    parts = []
    taken = state.mixture.rows(rng, PREDICTIVE_DRAWS)
    for answer, rows in zip(state.mixture.answers, taken, strict=True):
        changes = None
        if answer.columns is not None:
            coefficients = answer.coefficients[rows]
            changes = coefficients @ answer.columns.changes(problem, session).T
        if len(rows):
            theta, law = answer.theta[rows], answer.noise_law[rows]
            parts.append(HypothesisDraws(answer.estimate, theta, law, changes))
    return parts


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
    problem = assemble(
        measurement, planned.series, planned.covariates, gravity=request.gravity
    )
    model = budget_model(measurement, problem.series, measurement.nominal)
    return expected_effects(
        problem, SessionStates.of(problem), model, maps, request.effects, reference, rng
    )
