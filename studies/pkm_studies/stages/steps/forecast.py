"""The step of forecast compensation: plans its nodes, and fits those that were measured."""

from __future__ import annotations

from pathlib import Path

from pkm_studies.base import Stream
from pkm_studies.stages.forecast import files, section
from pkm_studies.stages.forecast.task import EstimatedParameters, forecast_task
from pkm_studies.stages.run_state import Fitted, StateT


def forecast_errors(
    state: StateT,
    knowledge: EstimatedParameters | None = None,
    readings: Path | None = None,
) -> StateT:
    """The state with its nodes, and with the table where they are measured.

    knowledge  what was identified; that of a fitted state by default
    readings   file of the nodes, in place of the study's

    Raises InputError for what [forecast] misstates.
    """
    state.progress.stage("forecast")
    study, rng = state.study, state.rng(Stream.FORECAST)
    if knowledge is None and isinstance(state, Fitted):
        count = len(state.resolved.machine.parameters)
        estimate = state.estimate
        knowledge = EstimatedParameters(
            estimate.theta[:count], estimate.covariance[:count, :count]
        )
    task = forecast_task(state.resolved, knowledge, rng)
    forecast, nodes = section.planned(task)
    table = task.table
    if readings is None and table.readings:
        readings = study.folder / table.readings
    if readings is None:
        written = {files.NODES: files.nodes_csv(task, nodes)}
    else:
        check = study.folder / table.check if table.check else None
        forecast, text = section.measured(task, forecast, readings, check, rng)
        written = {files.TABLE: text}
    return state.add_sections(forecast=forecast).replace(forecast_files=written)
