"""Makes the content of an export from the result in a folder."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.compensate.command_grid import GridAxis
from oed.model.machine import Machine
from oed.result import StudyResult
from pkm_studies.base import InputError
from pkm_studies.catalogue import Compensation, ControllerFormat, MeasuringPose
from pkm_studies.compensation import identified, table_grid
from pkm_studies.quantities import column
from pkm_studies.resolve.machine import study_kinematics
from pkm_studies.resolve.workspace import workspace_axes, workspace_commands
from pkm_studies.study import Study


def compensation(
    result: StudyResult,
    study: Study,
    folder: Path,
    controller: ControllerFormat,
    largest: int | None = None,
) -> Compensation:
    """The content of an export in a format.

    largest  number of commands of a table; `table_grid.COMMANDS` by default

    Raises InputError where nothing was identified, and where `largest` is too small.
    """
    kinematics, tables = study_kinematics(study), controller.tables
    machine = kinematics.machine
    parameters = identified.identified_parameters(result, machine, tables=tables)
    if parameters is None:
        raise InputError(
            "this result has no identified parameters",
            "run the study with readings: `oed identify STUDY --readings CSV --out DIR`",
            file=str(folder / "result.json"),
        )
    notes = [f"parameters: section {parameters.origin} of result.json"]
    held = study.machine.controller
    if held is not None and (controller.table or controller.joints is not None):
        notes.append(replaces(held))
    if identified.is_virtual(result):
        notes.append("the readings are simulated: these values fit no real machine")
    content = Compensation(
        study=result.study,
        version=result.version,
        machine=machine,
        kinematics=kinematics,
        identified=parameters,
        command=workspace_commands(study, kinematics),
        poses=_poses(result, machine),
        notes=(*notes, *parameters.conditions),
        tables=tuple(result.corrected.tables) if result.corrected and tables else (),
        controller=study.controller,
        held=held or "",
    )
    if controller.draws:
        draws = identified.drawn_parameters(result, machine, parameters, folder)
        content = dataclasses.replace(content, draws=draws)
    if not controller.table:
        return content
    return _with_grid(content, result, workspace_axes(study, machine), largest)


def replaces(controller: str) -> str:
    """How a file of a later round relates to what the controller holds."""
    return (
        f"the whole compensation: it replaces what the controller holds ({controller});"
        " do not add the two"
    )


def _with_grid(
    content: Compensation,
    result: StudyResult,
    axes: tuple[GridAxis, ...],
    largest: int | None,
) -> Compensation:
    """The content with the grid of its table, where its workspace is in reach."""
    kinematics = content.kinematics
    correction = table_grid.table_correction(content.further, content.identified.values)
    want = table_grid.with_offsets(
        table_grid.table_accuracy(kinematics, result.final_prediction),
        content.further,
        result.final_prediction,
    )
    most = table_grid.COMMANDS if largest is None else largest
    grid = table_grid.command_grid(axes, correction, want, most)
    if grid is None:
        return content
    notes = (*content.notes, *table_grid.sentences(grid, want))
    if grid.axes != axes:
        notes += (
            "the table is narrower than the workspace: its corners are out of reach",
        )
    return dataclasses.replace(content, grid=grid, notes=notes)


def _poses(result: StudyResult, machine: Machine) -> tuple[MeasuringPose, ...]:
    """The planned poses of the result, in working order."""
    if result.design is None:
        return ()
    return tuple(
        MeasuringPose(p.setup, p.run, _command(p.command, machine))
        for p in result.design.poses
    )


def _command(displayed: dict[str, float], machine: Machine) -> Array:
    values = []
    for coordinate in machine.command:
        name = column(coordinate.name, coordinate.unit)
        values.append(float(units.to_si(displayed[name], units.split(name)[1])))
    return np.array(values)
