"""Makes the content of an export from the result in a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from oed import units
from oed.arrays import Array
from oed.compensate.table import grid_nodes
from oed.kinematics import AssemblyError, Kinematics
from oed.machine import Machine
from oed.result import StudyResult
from pkm_studies.compensation import identified
from pkm_studies.compensation.content import Compensation, MeasuringPose
from pkm_studies.errors import InputError
from pkm_studies.resolve.machine import study_machine
from pkm_studies.resolve.quantities import column
from pkm_studies.resolve.resolved import prediction_commands
from pkm_studies.study import Study

#: places along a coordinate of the workspace where the study names none
PLACES = 5


def compensation(
    result: StudyResult, study: Study, folder: Path, *, tables: bool = False
) -> Compensation:
    """The content of an export. Raises InputError where nothing was identified.

    `tables` says whether the file holds tables of effects.
    """
    machine = study_machine(study)
    parameters = identified.identified_parameters(result, machine, tables=tables)
    if parameters is None:
        raise InputError(
            "this result has no identified parameters",
            "run the study with readings: `oed identify STUDY --readings CSV --out DIR`",
            file=str(folder / "result.json"),
        )
    kinematics = Kinematics(machine)
    notes = [f"parameters: section {parameters.origin} of result.json"]
    if identified.is_virtual(result):
        notes.append("the readings are simulated: these values fit no real machine")
    return Compensation(
        study=result.study,
        version=result.version,
        machine=machine,
        kinematics=kinematics,
        identified=parameters,
        command=workspace_commands(study, kinematics),
        poses=_poses(result, machine),
        notes=(*notes, *parameters.conditions),
        tables=tuple(result.corrected.tables) if result.corrected and tables else (),
    )


def workspace_commands(study: Study, kinematics: Kinematics) -> Array:
    """Commands (n, n_dof): those of [prediction], or a grid over the workspace."""
    machine = kinematics.machine
    command = prediction_commands(study, machine)
    if command is not None:
        return command
    knots = tuple(np.linspace(c.lower, c.upper, PLACES) for c in machine.command)
    return _reachable(kinematics, grid_nodes(knots))


def regular_commands(study: Study, kinematics: Kinematics) -> Array:
    """Those of `workspace_commands` at which every pose component has an error.

    Where a tilt is zero, its direction has none.
    """
    command = workspace_commands(study, kinematics)
    slopes = kinematics.error_components_jacobian(command)
    return np.asarray(command[np.isfinite(slopes).all(axis=(1, 2))])


def _reachable(kinematics: Kinematics, command: Array) -> Array:
    while len(command):
        try:
            kinematics.inverse(command)
        except AssemblyError as error:
            command = np.delete(command, error.indices, axis=0)
        else:
            return command
    return kinematics.machine.home_command[None]


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


def sentences_of(compensation: Compensation, extra: Sequence[str] = ()) -> list[str]:
    """The comments that open every file."""
    title = f"pkm-oed {compensation.version}, study {compensation.study}"
    return [title, f"machine {compensation.machine.name}", *compensation.notes, *extra]
