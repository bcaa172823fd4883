"""Several targets of one tracker: set-ups of one station, with what each of them read.

A map's [targets] has the place of each on the platform, by its name in the column `setup`.
Commands of a file are those of the machine's own tool point; a set-up's are those of its
target. Readings of a target without its orientation are a set-up of their own, so that an
orientation that was not measured stays out and costs no point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed import units
from oed.base import Array
from oed.instrument import Instrument
from oed.mechanism import NO_TOOL, Kinematics
from pkm_studies.base import InputError, Location
from pkm_studies.importers import nominal_poses
from pkm_studies.importers.base import Row
from pkm_studies.importers.map_tables import ColumnMap

STATION = "tracker"
#: end of the name of a target's readings without orientation
POINTS = "_points"


def at_targets(
    rows: Sequence[Row], mapping: ColumnMap, kinematics: Kinematics, location: Location
) -> list[Row]:
    """Rows whose commands are those of their target. Raises InputError.

    A target that the map does not have is refused.
    """
    if not mapping.targets:
        return list(rows)
    moved = [dict(row) for row in rows]
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    columns = [stems.get(c.name, "") for c in kinematics.machine.command]
    for target, members in nominal_poses.members_by_setup(rows).items():
        if target not in mapping.targets:
            remedy = f"give its place on the platform: {target} = [x, y, z]"
            raise location.key("targets").error("no such target", remedy, target)
        if not all(columns):
            continue  # joints were recorded
        command = nominal_poses.si_numbers([rows[k] for k in members], columns)
        tool = units.to_si(np.array(mapping.targets[target]), "mm")
        pose = kinematics.inverse(command, None, NO_TOOL)[0]
        start = kinematics.machine.with_tool(command, tool)
        command = kinematics.command_of_pose(pose, start, tool)
        for k, values in zip(members, command, strict=True):
            for name, value in zip(columns, values, strict=True):
                unit = name.rpartition("_")[2]
                moved[k][name] = repr(units.number(float(value), unit))
    return list(moved)


def split_by_channels(
    rows: Sequence[Row], tool: Instrument
) -> tuple[list[Row], dict[str, list[str]]]:
    """Rows, those without some channels in a set-up of their own; channels by set-up."""
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    columns = {c.name: stems[c.name] for c in tool.channels if c.name in stems}
    read_by_row = [[n for n, column in columns.items() if row[column]] for row in rows]
    channels: dict[str, list[str]] = {}
    for name, members in nominal_poses.members_by_setup(rows).items():
        channels[name] = max((read_by_row[k] for k in members), key=len)
    split: list[Row] = []
    for row, read in zip(rows, read_by_row, strict=True):
        name = row["setup"]
        if read and channels[name] != read:
            name = f"{name}{POINTS}"
            if channels.setdefault(name, read) != read:
                raise InputError(
                    f"{row['setup']} has readings of more than two sets of channels",
                    "leave out rows in which a coordinate or an angle is missing alone",
                    file="--map",
                    field="columns",
                )
        split.append({**row, "setup": name})
    return split, channels


def tool_of(setup: str, mapping: ColumnMap) -> Array:
    """The tool point (3,) of a set-up, m."""
    place = mapping.targets.get(setup.removesuffix(POINTS), mapping.tool_mm)
    return np.asarray(units.to_si(np.array(place), "mm"))
