"""Commands from poses as a user has them: lists, files, circles, lines, cubes, samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies import csv_table, quantities
from pkm_studies.base import Location
from pkm_studies.resolve.command_ranges import command_units
from pkm_studies.resolve.tool_points import ToolPoints, ranges
from pkm_studies.tables import CircleTable, CubeTable, GridTable, Span

#: fields of a table that give poses in place of a grid
FORMS = ("poses", "file", "circle", "line", "cube", "sample")
#: forms that give tool points, and may leave angles to coordinates of one value
POINT_FORMS = ("circle", "line", "cube")
#: poses sampled where a table gives none
DEFAULT_SAMPLE = 500
#: columns of the plane's first and second axis
CIRCLE_PLANES = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}
#: a joint may exceed its range by this much (m, rad)
SLACK = 1e-9


class Poses(NamedTuple):
    """Commands (n, n_dof), SI, and the run of each."""

    command: Array
    run: list[str]


def form(table: GridTable, location: Location) -> str | None:
    """The field that gives the poses; None for a grid. Raises InputError for two."""
    limits = [name for name in FORMS if getattr(table, name) is not None]
    if table.pairs_mm is not None:
        limits.insert(0, "pairs_mm")
    if len(limits) > 1:
        raise location.key(limits[1]).error(
            f"poses come from {' and '.join(limits)}", "make one table for each"
        )
    if limits == ["pairs_mm"]:
        return None
    if not limits and not table.coordinates:
        return "sample"
    return limits[0] if limits else None


def given_poses(
    table: GridTable,
    kind: str,
    kinematics: Kinematics,
    tool: tuple[float, float, float],
    location: Location,
) -> Poses:
    """The commands of a table in one of FORMS. Raises InputError."""
    machine, field = kinematics.machine, location.key(kind)
    if kind in POINT_FORMS:
        fixed = _single_values(table, machine, location)
        points, run = _points(table, kind)
        command = ToolPoints(kinematics, tool).commands(points, fixed, field)
        return Poses(command, run)
    if kind == "sample":
        return _sampled(table, kinematics, tool, location)
    if table.coordinates:
        key = next(iter(table.coordinates))
        raise location.key(key).error(f"{kind} says all about the poses", "remove it")
    if table.file is not None:
        return _listed_poses(Path(location.file).parent / table.file, machine, field)
    return _listed(table.poses or {}, machine, field)


# -- lists and files -------------------------------------------------------------------


def _listed(
    lists: Mapping[str, list[float]], machine: Machine, location: Location
) -> Poses:
    values: dict[str, Array] = {}
    for key, numbers in lists.items():
        name, unit = quantities.split_key(key, command_units(machine), location)
        values[name] = units.to_si(np.array(numbers), unit)
    command = _command(values, machine, location)
    return Poses(command, ["1"] * len(command))


def _listed_poses(path: Path, machine: Machine, location: Location) -> Poses:
    table = csv_table.read(path)
    in_file = Location(str(path))
    values: dict[str, Array] = {}
    for column in table.header:
        if column == "run":
            continue
        name, unit = quantities.split_key(column, command_units(machine), in_file)
        values[name] = units.to_si(table.numbers(column), unit)
    command = _command(values, machine, in_file)
    has_runs = "run" in table.header
    return Poses(command, table.cells("run") if has_runs else ["1"] * len(command))


def _command(
    values: Mapping[str, Array], machine: Machine, location: Location
) -> Array:
    """Commands (n, n_dof) from columns of equal length. Raises InputError."""
    for coordinate in machine.command:
        if coordinate.name not in values:
            key = quantities.column(coordinate.name, coordinate.unit)
            raise location.key(key).error("missing", "give one value a pose")
    lengths = {name: len(column) for name, column in values.items()}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {count}" for name, count in lengths.items())
        raise location.error(f"lists of unequal length: {counts}", "one value a pose")
    command = np.column_stack([values[c.name] for c in machine.command])
    if not len(command):
        raise location.error("the list is empty", "give at least one pose")
    return command


# -- circles, lines and cubes ----------------------------------------------------------


def _points(table: GridTable, kind: str) -> tuple[Array, list[str]]:
    """Tool points (n, 3), m, and the run of each."""
    if table.circle is not None:
        return circle_points(table.circle)
    if table.line is not None:
        line = table.line
        points = units.to_si(np.linspace(line.from_mm, line.to_mm, line.count), "mm")
    elif table.cube is not None:
        points = cube_points(table.cube)
    else:
        raise LookupError(f"the table has no points by {kind}")
    return points, [kind] * len(points)


def circle_points(circle: CircleTable) -> tuple[Array, list[str]]:
    """Points (n, 3), m, on a circle, one run a direction; a full turn has no end."""
    closed = math.isclose(circle.arc_deg % 360.0, 0.0)
    shares = np.linspace(0.0, 1.0, circle.count, endpoint=not closed)
    directions = ("ccw", "cw") if circle.direction == "both" else (circle.direction,)
    first, second = CIRCLE_PLANES[circle.plane]
    points, run = [], []
    for direction in directions:
        sense = 1.0 if direction == "ccw" else -1.0
        degrees = circle.start_deg + sense * circle.arc_deg * shares
        angle = units.to_si(degrees, "deg")
        around = np.zeros((circle.count, 3))
        around[:, first], around[:, second] = np.cos(angle), np.sin(angle)
        points.append(np.array(circle.centre_mm) + circle.radius_mm * around)
        run += [f"circle {circle.plane} {direction}"] * circle.count
    return units.to_si(np.concatenate(points), "mm"), run


def cube_points(cube: CubeTable) -> Array:
    """Points (count^3, 3), m, evenly spaced in a cube."""
    edge = np.linspace(-0.5, 0.5, cube.count) * cube.side_mm
    mesh = np.meshgrid(edge, edge, edge, indexing="ij")
    offsets = np.column_stack([axis.ravel() for axis in mesh])
    return units.to_si(np.array(cube.centre_mm) + offsets, "mm")


def _single_values(
    table: GridTable, machine: Machine, location: Location
) -> dict[str, float]:
    """SI values of the coordinates given with one value. Raises InputError."""
    values = {}
    for key, axis in table.coordinates.items():
        name, unit = quantities.split_key(key, command_units(machine), location)
        if not isinstance(axis, float | int):
            remedy = "give one value, and a table for each further one"
            raise location.key(key).error("beside points it has one value", remedy)
        values[name] = float(units.to_si(axis, unit))
    return values


# -- samples ---------------------------------------------------------------------------


def _sampled(
    table: GridTable,
    kinematics: Kinematics,
    tool: tuple[float, float, float],
    location: Location,
) -> Poses:
    """Commands of a Halton sequence over the ranges, those out of reach left out."""
    machine = kinematics.machine
    lower, upper = ranges(machine, tool)
    names = [c.name for c in machine.command]
    for key, axis in table.coordinates.items():
        if isinstance(axis, str):
            remedy = "give a grid, or a range to sample from"
            raise location.key(key).error("sampled poses hold no reading", remedy, axis)
        name, unit = quantities.split_key(key, command_units(machine), location)
        ends = [axis.from_, axis.to] if isinstance(axis, Span) else np.ravel(axis)
        spread = units.to_si(ends, unit)
        column = names.index(name)
        lower[column], upper[column] = spread.min(), spread.max()
    count = table.sample or DEFAULT_SAMPLE
    from scipy.stats import qmc  # takes a second to import

    shares = qmc.Halton(len(names), scramble=False).random(count + 1)[1:]
    command = lower + shares * (upper - lower)
    command = command[keep_within_reach(command, kinematics, tool)]
    if not len(command):
        raise location.key("sample").error(
            f"none of {count} sampled poses can be reached", "narrow the ranges", count
        )
    return Poses(command, ["sample"] * len(command))


def keep_within_reach(
    command: Array, kinematics: Kinematics, tool: tuple[float, float, float]
) -> Index:
    """Indices of the commands that assemble with all joints in their ranges."""
    reached = np.arange(len(command))
    joints = kinematics.machine.joints
    low = np.array([joint.lower for joint in joints]) - SLACK
    high = np.array([joint.upper for joint in joints]) + SLACK
    while reached.size:
        try:
            _, q = kinematics.sent(command[reached], np.array(tool))
        except AssemblyError as error:
            reached = np.delete(reached, error.indices)
            continue
        return reached[((q >= low) & (q <= high)).all(axis=1)]
    return reached
