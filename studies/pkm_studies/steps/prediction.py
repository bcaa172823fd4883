"""Steps that predict: accuracy over the workspace, and held-out readings."""

from __future__ import annotations

from pkm_studies.run_state import RunState, Stream
from pkm_studies.stages.predict.accuracy import prediction_section
from pkm_studies.stages.predict.held_out import held_out_sections
from pkm_studies.stages.predict.virtual_machines import realised_accuracy


def predict_accuracy(state: RunState) -> RunState:
    """Predict the residual accuracy over the workspace, and check it on machines.

    With readings of a virtual machine, which only exercise the plan, the prediction
    rests on the tolerances alone.
    """
    table, command = state.study.prediction, state.resolved.prediction_commands
    if table is None or command is None:
        return state
    assert state.readings is not None
    if state.fit_is_bad:
        return state.with_warnings(_withheld(state))
    state.progress.stage("prediction")
    series, virtual = state.readings.series, state.readings.truth is not None
    realised = realised_accuracy(
        state.measurement,
        series,
        command,
        table.reference,
        table.virtual_machines,
        state.rng(Stream.MACHINES),
        state.resolved.identification_stages,
        state.progress.share,
    )
    section = prediction_section(
        state.measurement,
        series,
        command,
        table.reference,
        state.rng(Stream.PREDICT),
        None if virtual else state.estimate,
        None if virtual else state.posterior,
        realised,
    )
    return state.with_sections(prediction=section)


def _withheld(state: RunState) -> str:
    """Why no accuracy is predicted from the fit without effects."""
    if state.corrected is None:
        return "The predicted accuracy is withheld: it would rest on a bad fit"
    return "The fit without effects is bad: no accuracy is predicted from it"


def predict_held_out(state: RunState) -> RunState:
    """Compare held-out readings with what the posterior predicts."""
    held_out = state.readings.held_out if state.readings is not None else None
    if held_out is None:
        return state
    if state.posterior is None:
        return state.with_warnings(
            "the readings of [readings] predict were not predicted, as [posterior] is"
            " not enabled"
        )
    assert state.estimate is not None
    state.progress.stage("held-out readings")
    sections = held_out_sections(
        state.measurement,
        held_out.series,
        held_out.y,
        state.estimate,
        state.posterior,
        state.rng(Stream.HELD_OUT),
    )
    return state.with_sections(held_out=sections)
