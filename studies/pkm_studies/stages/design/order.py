"""Orders a plan: set-ups by what has to be changed, readings by short joint travel.

Readings of a labelled run stay together. Runs whose order means something are kept as
they are: those read against their first pose, in passes, or chosen as a whole.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.design import move_times, order, schedule
from oed.measurement import Measurement, Series
from oed.model.machine import Machine
from oed.result import WorkingOrder
from pkm_studies.base import Location
from pkm_studies.resolve import (
    ResolvedStudy,
    check_tool_workspace,
    grid_commands,
    mid_range,
    solve_held,
)
from pkm_studies.tables import DesignTable, OrderTable

#: most random changes tried of a way; together with its readings, the most moves
KICKS, EFFORT = 200, 20_000
#: run of thermal reference readings
REFERENCE_RUN = "reference"


@dataclasses.dataclass(frozen=True)
class OrderedPlan:
    """Readings in working order; `scheduled` has thermal references in between."""

    series: tuple[Series, ...]
    scheduled: tuple[Series, ...]
    summary: WorkingOrder


@dataclasses.dataclass(frozen=True)
class _SetupOrder:
    """One set-up's readings in order.

    before, after   joint travel in the given order, and as ordered, s
    seconds         until the last reading ends
    exact           whether no order is shorter
    """

    series: Series
    scheduled: Series
    before: float
    after: float
    seconds: float
    exact: bool


def order_plan(
    table: DesignTable,
    location: Location,
    measurement: Measurement,
    retained: Sequence[Series],
    series: Sequence[Series],
    rng: np.random.Generator,
) -> OrderedPlan:
    """Readings of a plan in working order; retained ones come first in their set-up.

    table   the order that it asks for
    location  of the table, for errors

    Raises InputError where the thermal reference cannot be read in time.
    """
    location = location.key("order")
    mounted = list(dict.fromkeys(s.setup for s in retained))
    names = list(dict.fromkeys(s.setup for s in series))
    names, mounting = _order_setups(measurement, names, table.order, rng)
    labelled = [_added_readings(s) if s.setup in mounted else s for s in series]
    orders = {}
    for name in names:
        parts = [s for s in labelled if s.setup == name]
        orders[name] = _order_setup(measurement, name, parts, table, rng, location)
    setups = [n for n in mounted if n not in names] + names
    references = sum(len(o.scheduled) - len(o.series) for o in orders.values())
    summary = WorkingOrder(
        setups=setups,
        before_s=sum(o.before for o in orders.values()),
        after_s=sum(o.after for o in orders.values()),
        exact=all(o.exact for o in orders.values()),
        references=references,
        minutes=(mounting + sum(o.seconds for o in orders.values())) / 60.0,
    )
    ordered = {name: o.series for name, o in orders.items()}
    scheduled = {name: o.scheduled for name, o in orders.items()}
    return OrderedPlan(
        series=_joined_plan(setups, retained, ordered),
        scheduled=_joined_plan(setups, retained, scheduled),
        summary=summary,
    )


def check_reference(resolved: ResolvedStudy) -> None:
    """Raises InputError for thermal reference readings that no set-up can take."""
    table = resolved.study.design
    if table is None or table.order.reference_every_min is None:
        return
    location = resolved.study.location.key("design").key("order")
    for name in dict.fromkeys(s.setup for s in resolved.candidates):
        every = table.order.reference_every_min
        reference_command(resolved.measurement, name, table.order, every, location)


def _joined_plan(
    setups: Sequence[str], retained: Sequence[Series], new: Mapping[str, Series]
) -> tuple[Series, ...]:
    """Retained and new readings, set-up by set-up."""
    plan: list[Series] = []
    for name in setups:
        plan += [s for s in retained if s.setup == name]
        plan += [new[name]] if name in new else []
    return tuple(plan)


def _added_readings(series: Series) -> Series:
    """New readings in a set-up with retained ones: the names of their runs say so."""
    labels = ["added" if run == "1" else f"added {run}" for run in series.run]
    return dataclasses.replace(series, run=np.array(labels, dtype=np.str_))


def _order_setups(
    measurement: Measurement,
    names: list[str],
    table: OrderTable,
    rng: np.random.Generator,
) -> tuple[list[str], float]:
    """Set-ups in the order of least re-mounting, and the time for that, s."""
    changes = move_times.ChangeTimes(
        60.0 * table.change_tool_min,
        60.0 * table.change_place_min,
        60.0 * table.change_settings_min,
    )
    setups = [measurement.setups[name] for name in names]
    costs, first = move_times.remounting(setups, changes)
    route = order.order_setups(costs, rng, first)
    return [names[k] for k in route.indices], route.length


def _order_setup(
    measurement: Measurement,
    name: str,
    parts: list[Series],
    table: DesignTable,
    rng: np.random.Generator,
    location: Location,
) -> _SetupOrder:
    """The readings of one set-up by short joint travel, with thermal references."""
    whole, setup = _joined(measurement, name, parts), measurement.setups[name]
    speeds = _joint_speeds(measurement.machine, table.order)
    distance = move_times.travel_between(measurement, whole, speeds)
    start = None
    if table.order.start == "home":
        start = move_times.travel_from_home(measurement, whole, speeds)
    passes = not setup.protocol.average and len(setup.protocol.pass_names) > 1
    relative = setup.instrument.reference == "run"
    fixed = table.whole_runs or relative or passes
    route = order.order_poses(
        distance,
        rng,
        start,
        runs=_runs(whole, distance, fixed, rng),
        reversible=not fixed,
        kicks=_kicks(len(whole)),
    )
    ordered = whole.take(route.indices)
    reading = measurement.reading_seconds(name)
    before = float(distance[np.arange(len(whole) - 1), np.arange(1, len(whole))].sum())
    before += 0.0 if start is None else float(start[0])
    scheduled, seconds = ordered, route.length + reading * len(whole)
    every_min = table.order.reference_every_min
    if every_min is not None:
        timing = RouteTiming(route, speeds, reading)
        scheduled, seconds = add_reference_readings(
            measurement, whole, timing, table.order, every_min, location
        )
    return _SetupOrder(ordered, scheduled, before, route.length, seconds, route.exact)


def _joint_speeds(machine: Machine, table: OrderTable) -> list[float]:
    linear = float(units.to_si(table.speed_mm_s, "mm"))
    angular = float(units.to_si(table.speed_deg_s, "deg"))
    return [linear if joint.unit == "m" else angular for joint in machine.joints]


def _kicks(count: int) -> int:
    return min(KICKS, EFFORT // count)


def _runs(
    series: Series, distance: Array, fixed: bool, rng: np.random.Generator
) -> list[list[int]] | None:
    """Readings that stay together, each run ordered unless `fixed`.

    None where each reading is visited by itself.
    """
    labels = list(dict.fromkeys(series.run))
    if len(labels) == 1 and not fixed:
        return None
    runs = []
    for label in labels:
        members = np.flatnonzero(series.run == label)
        if not fixed:
            within = distance[np.ix_(members, members)]
            route = order.order_poses(within, rng, kicks=_kicks(len(members)))
            members = members[route.indices]
        runs.append([int(k) for k in members])
    return runs


def _joined(measurement: Measurement, setup: str, parts: list[Series]) -> Series:
    """Series of one set-up as one.

    Runs of one name with a reference of their own get a number.
    """
    if len(parts) == 1:
        return parts[0]
    if measurement.setups[setup].instrument.reference != "run":
        labels = [str(run) for s in parts for run in s.run]
        commands = np.vstack([s.reading_commands() for s in parts])
        return measurement.series(setup, commands, labels)
    runs: list[str] = []
    index: list[Index] = []
    poses = 0
    for s in parts:
        clash = set(runs) & set(s.run)
        number = len(index) + 1
        runs += [f"{run} ({number})" if clash else str(run) for run in s.run]
        index.append(s.index + poses)
        poses += len(s.q)
    return Series(
        setup=setup,
        q=np.vstack([s.q for s in parts]),
        start=np.vstack([s.start for s in parts]),
        command=np.vstack([s.command for s in parts]),
        index=np.vstack(index),
        run=np.array(runs, dtype=np.str_),
    )


# -- thermal reference readings --------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class RouteTiming:
    """A route through the readings, joint speeds (SI) and time of one reading, s."""

    route: order.Route
    speeds: Sequence[float]
    reading: float


def add_reference_readings(
    measurement: Measurement,
    series: Series,
    timing: RouteTiming,
    table: OrderTable,
    every_min: float,
    location: Location,
) -> tuple[Series, float]:
    """The readings in time with reference readings in between; when the last ends, s.

    Raises InputError where the set-up has a reference of its own, or time is too short.
    """
    every = location.key("reference_every_min")
    command = reference_command(measurement, series.setup, table, every_min, location)
    if command is None:
        first = timing.route.indices[0]
        command = np.asarray(series.reading_commands()[first])
    reference = measurement.series(series.setup, command[None])
    joints = series.q[series.index[:, 0]]
    travel = move_times.travel_times(reference.q[:1], joints, timing.speeds)[0]
    home = 0.0
    if table.start == "home":
        home = float(
            move_times.travel_from_home(measurement, reference, timing.speeds)[0]
        )
    try:
        timed = schedule.interleave(
            timing.route,
            timing.reading,
            60.0 * every_min,
            travel,
            travel,
            timing.reading,
            home,
        )
    except ValueError as error:
        raise every.error(str(error), "raise it") from error
    commands, runs = series.reading_commands(), []
    scheduled = []
    for k in timed.pose:
        scheduled.append(command if k < 0 else commands[k])
        runs.append(REFERENCE_RUN if k < 0 else str(series.run[k]))
    planned = measurement.series(series.setup, np.array(scheduled), runs)
    return planned, timed.seconds


def reference_command(
    measurement: Measurement,
    name: str,
    table: OrderTable,
    every_min: float,
    location: Location,
) -> Array | None:
    """The reference's command (n_dof,) in a set-up; None for the route's first pose.

    Raises InputError where the set-up has a reference of its own, or the pose is none.
    """
    setup = measurement.setups[name]
    if setup.instrument.reference == "run":
        raise location.key("reference_every_min").error(
            f"the first pose of each run is the reference of {name}",
            "remove it",
            every_min,
        )
    if not table.reference:
        return None
    field, machine = location.key("reference"), measurement.machine
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
