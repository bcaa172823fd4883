"""Grids of commanded poses: every combination of coordinate values, grouped in runs.

The first coordinate of the machine's command varies slowest. An instrument that holds
its reading, such as a ball bar, can lead one coordinate. Commands are (n, n_dof), SI.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.instrument import Setup
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies import csv_table, quantities
from pkm_studies.base import Location
from pkm_studies.quantities import format_value
from pkm_studies.resolve.machine import (
    REACH_REMEDY,
    check_joint_range,
    known_name,
    reach_problem,
)
from pkm_studies.resolve.tool_points import ToolPoints, ranges
from pkm_studies.tables import (
    CIRCLE_PLANES,
    Axis,
    CircleTable,
    GridTable,
    OrderTable,
    Span,
)


# Ranges of commands: their units, and what is outside the workspace.
def command_units(machine: Machine) -> dict[str, str]:
    """SI units of the command coordinates, by name."""
    return {c.name: c.unit for c in machine.command}


def check_workspace(
    machine: Machine, command: Array, keys: Mapping[str, str], location: Location
) -> None:
    """Raises InputError for the first command outside the machine's workspace."""
    for _, name, value, lower, upper in machine.out_of_range(command)[:1]:
        unit = command_units(machine)[name]
        key = keys.get(name, name)
        stated, low, high = (
            quantities.format_as(v, unit, key) for v in (value, lower, upper)
        )
        raise location.key(key).error(
            f"{stated} is outside the workspace of {machine.name}",
            f"{name} goes from {low} to {high}",
        )


def check_tool_workspace(
    kinematics: Kinematics,
    command: Array,
    keys: Mapping[str, str],
    location: Location,
    tool: Sequence[float],
) -> None:
    """The same of a tool's commands.

    The workspace moves with the tool as it points at home. Where a command is outside
    it, it counts whether the reference tool is outside as well.
    """
    machine = kinematics.machine
    outside = {row for row, *_ in machine.out_of_range(command, tuple(tool))}
    if outside:
        rows = command[sorted(outside)]
        at_reference = kinematics.reference_tool_commands(rows, np.array(tool))
        check_workspace(machine, at_reference, keys, location)


# Commands from poses as a user has them: lists, files, circles, lines, cubes, samples.

#: fields of a table that give poses in place of a grid
FORMS = ("poses", "file", "circle", "line", "cube", "sample")
#: forms that give tool points, and may leave angles to coordinates of one value
POINT_FORMS = ("circle", "line", "cube")
DEFAULT_SAMPLE = 500  #: poses sampled where a table gives none
RANGE_TOLERANCE = 1e-9  #: a joint may exceed its range by this much (m, rad)


Poses = tuple[Array, list[str]]  #: commands (n, n_dof), SI, and the run of each


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
    machine = kinematics.machine
    field = location.key(kind)
    if kind in POINT_FORMS:
        fixed = {}  # coordinates given with one value, SI
        for column, axis in table.coordinates.items():
            name, unit = quantities.split_key(column, command_units(machine), location)
            if not isinstance(axis, float | int):
                remedy = "give one value, and a table for each further one"
                raise location.key(column).error(
                    "beside points it has one value", remedy
                )
            fixed[name] = float(units.to_si(axis, unit))
        points, run = _points(table, kind)
        return ToolPoints(kinematics, tool).commands(points, fixed, field), run
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
    return command, ["1"] * len(command)


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
    return command, table.cells("run") if has_runs else ["1"] * len(command)


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
        edge = np.linspace(-0.5, 0.5, table.cube.count) * table.cube.side_mm
        mesh = np.meshgrid(edge, edge, edge, indexing="ij")
        offsets = np.column_stack([axis.ravel() for axis in mesh])
        points = units.to_si(np.array(table.cube.centre_mm) + offsets, "mm")
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
    return command, ["sample"] * len(command)


def keep_within_reach(
    command: Array, kinematics: Kinematics, tool: tuple[float, float, float]
) -> Index:
    """Indices of the commands that assemble with all joints in their ranges."""
    reached = np.arange(len(command))
    joints = kinematics.machine.joints
    low = np.array([joint.lower for joint in joints]) - RANGE_TOLERANCE
    high = np.array([joint.upper for joint in joints]) + RANGE_TOLERANCE
    while reached.size:
        try:
            _, q = kinematics.sent(command[reached], np.array(tool))
        except AssemblyError as error:
            reached = np.delete(reached, error.indices)
            continue
        return reached[((q >= low) & (q <= high)).all(axis=1)]
    return reached


MAX_POSES = 200_000  #: most poses of one grid
#: how far beyond its range (m, rad) a joint may be before a pose is refused
FULL_TURN = 2.0 * math.pi


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReferencePlan:
    """A named plan that the study gives: readings in one or more set-ups."""

    name: str
    series: tuple[Series, ...]

    @property
    def setups(self) -> tuple[str, ...]:
        """Names of the set-ups it reads in, in order."""
        return tuple(dict.fromkeys(s.setup for s in self.series))


@dataclasses.dataclass(frozen=True)
class Circles:
    """Circles of readings in one set-up, for a map of the condition number.

    lower, upper  range of the spacing coordinate, SI
    """

    title: str
    setup: str
    circles: tuple[int, ...]  #: numbers of circles to try
    points: tuple[int, ...]  #: numbers of points on a circle to try
    measurement: Measurement
    across: int  #: column of the coordinate that spaces the circles
    around: int  #: column of the angle that runs round each circle
    hold: str | None  #: coordinate that the instrument leads, if any
    lower: float
    upper: float
    location: Location
    further: tuple[Series, ...] = ()  #: series of a reference plan that is read as well

    def every_series(self) -> list[list[Series]]:
        """Readings: a list a number of circles, in it an entry a number of points.

        One circle lies in the middle. The held coordinates of all are solved together.
        Raises InputError where the instrument cannot hold its reading.
        """
        numbers = [(m, n) for m in self.circles for n in self.points]
        commands = [self._commands(m, n) for m, n in numbers]
        ends = np.cumsum([len(command) for command in commands])
        solved, _ = solve_held(
            self.measurement,
            self.setup,
            np.vstack(commands),
            self.hold,
            self.location,
            strict=True,
        )
        parts = np.split(solved, ends[:-1])
        pairs = zip(numbers, parts, strict=True)
        series = [self._series(command, *details) for details, command in pairs]
        size = len(self.points)
        return [series[k : k + size] for k in range(0, len(series), size)]

    def _commands(self, m: int, n: int) -> Array:
        """Commands (m n, n_dof), the held coordinate at 0."""
        levels = np.array([(self.lower + self.upper) / 2.0])
        if m > 1:
            levels = np.linspace(self.lower, self.upper, m)
        angles = np.linspace(0.0, FULL_TURN, n, endpoint=False)
        command = np.zeros((m * n, len(self.measurement.machine.command)))
        command[:, self.across] = np.repeat(levels, n)
        command[:, self.around] = np.tile(angles, m)
        return command

    def _series(self, command: Array, m: int, n: int) -> Series:
        numbers = np.repeat(np.arange(1, m + 1), n)
        labels = [f"circle {number}" for number in numbers]
        return planned_series(
            self.measurement, self.setup, command, labels, self.location
        )


def grid_commands(
    axes: Mapping[str, Axis], machine: Machine, location: Location
) -> tuple[Array, str | None, dict[str, str]]:
    """Commands of a grid, the coordinate to hold, and the key of each coordinate.

    A coordinate to hold is 0 in the commands. Raises InputError for unknown or missing
    coordinates, wrong units, and grids that are too large.
    """
    values: dict[str, Array] = {}
    keys: dict[str, str] = {}
    hold: str | None = None
    for key, axis in axes.items():
        field = location.key(key)
        name, unit = _coordinate(key, axis, machine, location)
        if name in keys:
            raise field.error(f"{name} is given twice", f"keep {keys[name]} or {key}")
        keys[name] = key
        if isinstance(axis, str):
            if hold is not None:
                raise field.error(
                    "one coordinate at most can be held",
                    f"give {key} or {keys[hold]} values",
                )
            hold = name
        values[name] = units.to_si(_axis_values(axis, field), unit)
    for coordinate in machine.command:
        if coordinate.name not in values:
            column = quantities.column(coordinate.name, coordinate.unit)
            remedy = f'give {column}, or {coordinate.name} = "hold" where the instrument leads the tool'
            raise location.key(column).error("missing", remedy)
    count = math.prod(len(v) for v in values.values())
    if count > MAX_POSES:
        remedy = f"take at most {MAX_POSES}: fewer values a coordinate"
        raise location.error(f"the grid has {count} poses", remedy)
    axis_values = [values[c.name] for c in machine.command]
    mesh = np.meshgrid(*axis_values, indexing="ij")
    return np.column_stack([m.ravel() for m in mesh]), hold, keys


def _coordinate(
    key: str, axis: Axis, machine: Machine, location: Location
) -> tuple[str, str]:
    """Name and unit of a grid's key; a held coordinate needs no unit."""
    unit_of = command_units(machine)
    if axis == "hold" and key in unit_of:
        return key, unit_of[key]
    return quantities.split_key(key, unit_of, location)


def _axis_values(axis: Axis, location: Location) -> Array:
    if isinstance(axis, str):
        return np.zeros(1)
    if isinstance(axis, Span):
        if axis.count > MAX_POSES:
            raise location.key("count").error(
                "too many values", f"take at most {MAX_POSES}", axis.count
            )
        return np.linspace(axis.from_, axis.to, axis.count, endpoint=axis.endpoint)
    values = np.atleast_1d(np.asarray(axis, dtype=float))
    if not values.size:
        raise location.error("the list is empty", "give at least one value")
    return values


def solve_held(
    measurement: Measurement,
    setup: str,
    command: Array,
    hold: str | None,
    location: Location,
    *,
    strict: bool,
) -> tuple[Array, int]:
    """Commands with one coordinate solved for the held reading; the number dropped.

    With `strict`, raises InputError where some pose has no solution; otherwise only
    where no pose has one.
    """
    if hold is None:
        return command, 0
    location = location.key(hold)
    instrument = measurement.setups[setup].instrument
    if instrument.fixed_reading is None:
        problem = f"{instrument.name} holds no reading by design"
        raise location.error(problem, f"give {hold} values with a unit", "hold")
    try:
        solved, solvable = commands_at_fixed_reading(measurement, setup, command, hold)
    except AssemblyError as error:
        problem = reach_problem(error, measurement.machine)
        raise location.error(problem, "narrow the grid", "hold") from error
    lost = int((~solvable).sum())
    if lost == len(command) or (strict and lost):
        first = command[np.flatnonzero(~solvable)[0]]
        others = [
            f"{c.name} {format_value(value, c.unit)}"
            for c, value in zip(measurement.machine.command, first, strict=True)
            if c.name != hold
        ]
        problem = (
            f"at {lost} of {len(command)} poses no {hold} lets {setup} read what it"
            f" holds, the first at {', '.join(others)}"
        )
        remedy = "move the grid or the teach pose, or take another bar"
        raise location.error(problem, remedy, "hold")
    return solved[solvable], lost


def planned_series(
    measurement: Measurement,
    setup: str,
    command: Array,
    run: Sequence[str],
    location: Location,
) -> Series:
    """Readings at commands in the protocol's passes. Raises InputError out of reach."""
    try:
        series = measurement.series(setup, command, run)
    except AssemblyError as error:
        problem = reach_problem(error, measurement.machine)
        raise location.error(problem, REACH_REMEDY) from error
    if not len(series):
        raise location.error(
            "every run is one point: its reference, and no reading",
            "add poses along the run, or choose another runs_by",
        )
    check_joint_range(measurement.machine, series.command, series.q, location)
    return series.expand_passes(measurement.setups[setup].protocol)


def grid_series(
    table: GridTable, measurement: Measurement, location: Location, *, strict: bool
) -> tuple[Series, int]:
    """Series of a grid's table, and the number of poses dropped (see `solve_held`)."""
    machine = measurement.machine
    setup = measurement.setups[table.setup]
    kind = form(table, location)
    if table.pairs_mm is not None:
        command, run = _pairs(table, measurement.kinematics, setup, location)
        return planned_series(measurement, table.setup, command, run, location), 0
    if kind is not None:
        listed = given_poses(table, kind, measurement.kinematics, setup.tool, location)
        keys = dict.fromkeys(command_units(machine), kind)
        check_tool_workspace(
            measurement.kinematics, listed[0], keys, location, setup.tool
        )
        return planned_series(measurement, table.setup, *listed, location), 0
    command, hold, keys = grid_commands(table.coordinates, machine, location)
    if hold is not None:
        command = mid_range(command, hold, machine, setup)
    check_tool_workspace(measurement.kinematics, command, keys, location, setup.tool)
    command, lost = solve_held(
        measurement, table.setup, command, hold, location, strict=strict
    )
    run = ["1"] * len(command)  # or one for each value of a coordinate
    if table.runs_by is not None:
        names = [c.name for c in machine.command]
        known_name(table.runs_by, names, location.key("runs_by"), "coordinate")
        k = names.index(table.runs_by)
        values = [
            format_value(value, machine.command[k].unit) for value in command[:, k]
        ]
        run = [f"{table.runs_by}={value.replace(' ', '')}" for value in values]
    return planned_series(measurement, table.setup, command, run, location), lost


def mid_range(command: Array, hold: str, machine: Machine, setup: Setup) -> Array:
    """Commands with the held coordinate in the middle of its range, to start solving."""
    k = [c.name for c in machine.command].index(hold)
    limits = machine.workspace(setup.tool)[k]
    started = command.copy()
    started[:, k] = (limits.lower + limits.upper) / 2.0
    return started


def _pairs(
    table: GridTable, kinematics: Kinematics, setup: Setup, location: Location
) -> tuple[Array, list[str]]:
    """Commands and runs of point pairs: two poses a run, of which the first is zero."""
    if table.coordinates or table.runs_by is not None:
        raise location.key("pairs_mm").error(
            "pairs say all about the poses", "remove the coordinates and runs_by"
        )
    machine = kinematics.machine
    translations = [c.unit == "m" for c in machine.command]
    compares = setup.instrument.reference == "run"
    if not compares or not all(translations) or len(translations) != 3:
        problem = (
            "pairs are for instruments that compare two poses, on machines commanded in"
            " x, y, z"
        )
        raise location.key("pairs_mm").error(
            problem, "give a grid of coordinates instead"
        )
    points = units.to_si(np.array(table.pairs_mm, dtype=float), "mm").reshape(-1, 3)
    if not points.size:
        raise location.key("pairs_mm").error(
            "the list is empty", "give at least one pair"
        )
    keys = dict.fromkeys(command_units(machine), "pairs_mm")
    check_tool_workspace(kinematics, points, keys, location, setup.tool)
    return points, [f"pair {i // 2 + 1}" for i in range(len(points))]


# The pose that a plan repeats to see heat: [design.order] reference.
def reference_command(
    measurement: Measurement,
    name: str,
    table: OrderTable,
    every_min: float,
    location: Location,
) -> Array | None:
    """The reference's command (n_dof,), or None: the route's first. Raises InputError."""
    setup = measurement.setups[name]
    if setup.instrument.reference == "run":
        problem = f"the first pose of each run is the reference of {name}"
        raise location.key("reference_every_min").error(problem, "remove it", every_min)
    if not table.reference:
        return None
    field = location.key("reference")
    machine = measurement.machine
    command, hold, keys = grid_commands(table.reference, machine, field)
    if len(command) != 1:
        raise field.error(
            "the reference is one pose", "give one value for each coordinate"
        )
    if hold is not None:
        command = mid_range(command, hold, machine, setup)
    check_tool_workspace(measurement.kinematics, command, keys, field, setup.tool)
    command, _ = solve_held(measurement, name, command, hold, field, strict=True)
    return np.asarray(command[0])
