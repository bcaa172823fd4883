"""Grids of commanded poses: values of each coordinate combined, held by the instrument
where asked, in runs.

The coordinate that comes first in the machine's command varies slowest. Commands are
(n, n_dof) arrays, SI.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from oed import units
from oed.arrays import Array
from oed.instrument import Setup
from oed.kinematics import AssemblyError
from oed.machine import Coordinate, Machine
from oed.measurement import Measurement, Series
from pkm_studies.errors import Place, suggest
from pkm_studies.resolve import quantities
from pkm_studies.study.load import Axis, GridTable, Span

MOST = 200_000  # poses of one grid
#: how far beyond its range (m, rad) a joint may be before a pose is refused
SLACK = 1e-9


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReferencePlan:
    """A named plan: readings in one or more set-ups."""

    name: str
    series: tuple[Series, ...]

    @property
    def setups(self) -> tuple[str, ...]:
        """Names of the set-ups it reads in, in order."""
        return tuple(dict.fromkeys(s.setup for s in self.series))


@dataclasses.dataclass(frozen=True)
class Circles:
    """m circles of n points each for the condition number's map; `measurement` holds
    the one set-up.
    """

    title: str
    setup: str
    circles: tuple[int, ...]
    points: tuple[int, ...]
    measurement: Measurement
    across: int  # column of the coordinate that spaces the circles
    around: int  # column of the angle that runs round each
    hold: str | None
    lower: float
    upper: float
    place: Place

    def series(self, m: int, n: int) -> Series:
        """Readings on m circles from `lower` to `upper` (one: in the middle), n points
        each from angle 0.

        Raises InputError where the instrument cannot hold its reading there.
        """
        levels = (
            np.linspace(self.lower, self.upper, m)
            if m > 1
            else [(self.lower + self.upper) / 2.0]
        )
        angles = np.linspace(0.0, 2.0 * math.pi, n, endpoint=False)
        command = np.zeros((m * n, len(self.measurement.machine.command)))
        command[:, self.across] = np.repeat(levels, n)
        command[:, self.around] = np.tile(angles, m)
        command, _ = held(
            self.measurement, self.setup, command, self.hold, self.place, strict=True
        )
        labels = [f"circle {k + 1}" for k in range(m) for _ in range(n)]
        return series(self.measurement, self.setup, command, labels, self.place)


def wanted(machine: Machine) -> dict[str, str]:
    """Command coordinates with their SI units."""
    return {c.name: c.unit for c in machine.command}


def expand(
    axes: Mapping[str, Axis], machine: Machine, place: Place
) -> tuple[Array, str | None, dict[str, str]]:
    """Commands of a grid; the coordinate to be held, if any (0 in the commands); each
    coordinate's key.

    Raises InputError for unknown or missing coordinates, wrong units, and grids that
    are too large.
    """
    values: dict[str, Array] = {}
    keys: dict[str, str] = {}
    hold: str | None = None
    for key, axis in axes.items():
        name, unit = _coordinate(key, axis, machine, place)
        if name in keys:
            raise place.key(key).error(
                f"{name} is given twice", f"keep {keys[name]} or {key}"
            )
        keys[name] = key
        if isinstance(axis, str):
            if hold is not None:
                raise place.key(key).error(
                    "one coordinate at most can be held",
                    f"give {key} or {keys[hold]} values",
                )
            hold = name
        values[name] = units.to_si(_numbers(axis, place.key(key)), unit)
    for c in machine.command:
        if c.name not in keys:
            key = quantities.column(c.name, c.unit)
            raise place.key(key).error(
                "missing",
                f'give {key}, or {c.name} = "hold" where the instrument leads the tool',
            )
    count = math.prod(len(v) for v in values.values())
    if count > MOST:
        raise place.error(
            f"the grid has {count} poses",
            f"take at most {MOST}: fewer values a coordinate",
        )
    mesh = np.meshgrid(*[values[c.name] for c in machine.command], indexing="ij")
    return np.column_stack([m.ravel() for m in mesh]), hold, keys


def _coordinate(
    key: str, axis: Axis, machine: Machine, place: Place
) -> tuple[str, str]:
    """Name and unit of a grid's key; a held coordinate needs no unit."""
    known = wanted(machine)
    if axis == "hold" and key in known:
        return key, known[key]
    return quantities.split(key, known, place)


def _numbers(axis: Axis, place: Place) -> Array:
    if isinstance(axis, str):
        return np.zeros(1)
    if isinstance(axis, Span):
        if axis.count > MOST:
            raise place.key("count").error(
                "too many values", f"take at most {MOST}", axis.count
            )
        return np.linspace(axis.from_, axis.to, axis.count, endpoint=axis.endpoint)
    numbers = np.atleast_1d(np.asarray(axis, dtype=float))
    if not numbers.size:
        raise place.error("the list is empty", "give at least one value")
    return numbers


def in_workspace(
    machine: Machine,
    command: Array,
    keys: Mapping[str, str],
    place: Place,
    tool: Sequence[float] = (0.0, 0.0, 0.0),
) -> None:
    """Raises InputError for the first command outside the machine's workspace."""
    for _, name, value, lower, upper in machine.out_of_range(command, tool)[:1]:
        unit = wanted(machine)[name]
        told = f"{quantities.told(lower, unit)} to {quantities.told(upper, unit)}"
        key = keys.get(name, name)
        found = quantities.told(value, unit)
        raise place.key(key).error(
            f"{found} is outside the workspace of {machine.name}",
            f"{name} goes from {told}",
        )


def held(
    measurement: Measurement,
    setup: str,
    command: Array,
    hold: str | None,
    place: Place,
    *,
    strict: bool,
) -> tuple[Array, int]:
    """Commands with one coordinate solved so that the instrument reads what it holds;
    how many were dropped.

    `strict`: raise InputError where that is impossible at some pose; else only where it
    is impossible at all.
    """
    if hold is None:
        return command, 0
    instrument = measurement.setups[setup].instrument
    if instrument.holds is None:
        problem = f"{instrument.name} holds no reading by design"
        raise place.key(hold).error(problem, f"give {hold} values with a unit", "hold")
    try:
        solved, found = measurement.hold(setup, command, hold)
    except AssemblyError as error:
        raise place.key(hold).error(str(error), "narrow the grid", "hold") from error
    lost = int((~found).sum())
    if lost == len(command) or (strict and lost):
        first = ", ".join(
            f"{c.name} {quantities.told(v, c.unit)}"
            for c, v in zip(
                measurement.machine.command,
                command[np.flatnonzero(~found)[0]],
                strict=True,
            )
            if c.name != hold
        )
        problem = (
            f"at {lost} of {len(command)} poses no {hold} lets {setup} read what it"
            f" holds, the first at {first}"
        )
        raise place.key(hold).error(
            problem, "move the grid or the teach pose, or take another bar", "hold"
        )
    return solved[found], lost


def series(
    measurement: Measurement,
    setup: str,
    command: Array,
    run: Sequence[str],
    place: Place,
) -> Series:
    """Readings at commands; raises InputError where a pose is out of reach or a joint
    out of its range.
    """
    try:
        made = measurement.series(setup, command, run)
    except AssemblyError as error:
        raise place.error(str(error), "keep to poses the machine can reach") from error
    in_joint_range(measurement.machine, made, place)
    return made.passes(measurement.setups[setup].protocol)


def in_joint_range(machine: Machine, made: Series, place: Place) -> None:
    """Raises InputError where the joints of a series leave their range."""
    for k, joint in enumerate(machine.joints):
        low, high = float(made.q[:, k].min()), float(made.q[:, k].max())
        if low < joint.lower - SLACK or high > joint.upper + SLACK:
            value = quantities.told(
                low if low < joint.lower - SLACK else high, joint.unit
            )
            told = (
                f"{quantities.told(joint.lower, joint.unit)} to"
                f" {quantities.told(joint.upper, joint.unit)}"
            )
            problem = f"a pose needs {joint.name} = {value}, outside the joint's range"
            raise place.error(
                problem, f"{joint.name} goes from {told}: keep to poses within"
            )


def labels(
    command: Array, by: str | None, coordinates: Sequence[Coordinate], place: Place
) -> list[str]:
    """Run of each pose: "1", or one run for each value of the coordinate `by`
    (`z=1146mm`).
    """
    if by is None:
        return ["1"] * len(command)
    names = [c.name for c in coordinates]
    if by not in names:
        raise place.key("runs_by").error("no such coordinate", suggest(by, names), by)
    k = names.index(by)
    told = [
        quantities.told(v, coordinates[k].unit).replace(" ", "") for v in command[:, k]
    ]
    return [f"{by}={t}" for t in told]


def grid(
    table: GridTable, measurement: Measurement, place: Place, *, strict: bool
) -> tuple[Series, int]:
    """Series of a [[design.candidates]] or [[design.reference]] table; how many poses
    it dropped (see `held`).
    """
    machine = measurement.machine
    if table.pairs_mm is not None:
        command, run = _pairs(table, machine, measurement.setups[table.setup], place)
        return series(measurement, table.setup, command, run, place), 0
    command, hold, keys = expand(table.coordinates, machine, place)
    tool = measurement.setups[table.setup].tool
    if hold is not None:  # solved below, within its range
        column = [c.name for c in machine.command].index(hold)
        command[:, column] = (
            machine.workspace(tool)[column].lower
            + machine.workspace(tool)[column].upper
        ) / 2.0
    in_workspace(machine, command, keys, place, tool)
    command, lost = held(measurement, table.setup, command, hold, place, strict=strict)
    run = labels(command, table.runs_by, machine.command, place)
    return series(measurement, table.setup, command, run, place), lost


def _pairs(
    table: GridTable, machine: Machine, setup: Setup, place: Place
) -> tuple[Array, list[str]]:
    """Each pair of points is a run of two poses, of which the first is the reference."""
    if table.coordinates or table.runs_by is not None:
        raise place.key("pairs_mm").error(
            "pairs say all about the poses", "remove the coordinates and runs_by"
        )
    if (
        setup.instrument.reference != "run"
        or any(c.unit != "m" for c in machine.command)
        or len(machine.command) != 3
    ):
        problem = (
            "pairs are for instruments that compare two poses, on machines commanded in"
            " x, y, z"
        )
        raise place.key("pairs_mm").error(problem, "give a grid of coordinates instead")
    points = units.to_si(np.array(table.pairs_mm, dtype=float), "mm").reshape(-1, 3)
    if not points.size:
        raise place.key("pairs_mm").error("the list is empty", "give at least one pair")
    in_workspace(
        machine, points, dict.fromkeys(wanted(machine), "pairs_mm"), place, setup.tool
    )
    return points, [f"pair {i // 2 + 1}" for i in range(len(points))]
