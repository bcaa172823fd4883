"""Poses of the nominal machine, and the orientations that were read compared with them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from oed import units
from oed.base import Array
from oed.instrument import Instrument
from oed.mechanism import AssemblyError, Kinematics
from pkm_studies.base import InputError
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import orientations
from pkm_studies.importers.base import Row
from pkm_studies.importers.map_tables import ColumnMap
from pkm_studies.resolve import ToolPoints


def nominal_frames(
    rows: Sequence[Row], kinematics: Kinematics, mapping: ColumnMap
) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and tool points (n, 3), m, of the nominal machine; NaN out of reach.

    At the recorded joints where there are any, else at the commands. Raises InputError.
    """
    rotations = np.full((len(rows), 3, 3), np.nan)
    points = np.full((len(rows), 3), np.nan)
    for name, members in members_by_setup(rows).items():
        tool = units.to_si(mapping.targets.get(name, mapping.tool_mm), "mm")
        of_target = [rows[k] for k in members]
        rotations[members], points[members] = _frames(of_target, kinematics, tool)
    return rotations, points


def members_by_setup(rows: Sequence[Row]) -> dict[str, list[int]]:
    """Numbers of the rows of each set-up, from 0."""
    members: dict[str, list[int]] = {}
    for k, row in enumerate(rows):
        members.setdefault(row["setup"], []).append(k)
    return members


def _frames(
    rows: Sequence[Row], kinematics: Kinematics, tool: Array
) -> tuple[Array, Array]:
    """The same of one target at a tool point (3,), m."""
    machine = kinematics.machine
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    joints = [stems.get(joint.name, "") for joint in machine.joints]
    if not all(joints):
        commanded = [channel_column(rows, c.name) for c in machine.command]
        tool_points = ToolPoints(kinematics, tool.tolist())
        return tool_points.frames(si_numbers(rows, commanded))
    try:
        poses = kinematics.start_poses(si_numbers(rows, joints))
    except AssemblyError as error:
        row = int(np.min(error.indices)) + 1 if len(error.indices) else 1
        raise InputError(
            f"the nominal machine does not assemble at the joints of reading {row}",
            "check factors and offsets of the joints, and the machine's geometry",
            file="--map",
            field="columns",
        ) from error
    return kinematics.frames(poses, tool)[:2]


def channel_column(rows: Sequence[Row], stem: str) -> str:
    """Name of the readings column of a quantity. Raises InputError."""
    for name in rows[0]:
        if name.rpartition("_")[0] == stem:
            return name
    raise InputError(
        f"no column for {stem}",
        "commanded poses are needed: add the column to [columns] of a --map file, or"
        " give a second file of poses",
        file="--map",
    )


def si_numbers(rows: Sequence[Row], names: list[str]) -> Array:
    """SI values (n, k) of columns; NaN where a cell is empty."""
    values = np.full((len(rows), len(names)), np.nan)
    for j, name in enumerate(names):
        factor = units.factor(name.rpartition("_")[2])
        for i, row in enumerate(rows):
            if row[name]:
                values[i, j] = factor * float(row[name])
    return values


def check_orientations(
    rows: Sequence[Row],
    mapping: ColumnMap,
    kinematics: Kinematics,
    tool: Instrument,
    table: CsvTable,
    turn: Rotation | None = None,
) -> None:
    """Compare the orientations that were read with those of the nominal machine.

    turn  of the instrument's frame into the machine's

    Raises InputError for other ones: in another order, or inverted.
    """
    stated = tool.orientation
    if stated is None or tool.reference is not None:
        return
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    names = {stem: name for stem, name in stems.items() if stem in stated.names}
    if not set(stated.axis_names) <= set(names):
        return
    wanted, _ = nominal_frames(rows, kinematics, mapping)
    read = orientations.row_orientations(rows, names, stated)
    is_whole = len(names) == len(stated.names) and not stated.axis_only
    orientations.check_sense(
        turn, read, wanted, mapping.orientation, table.file, is_whole=is_whole
    )
