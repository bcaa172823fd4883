"""Puts thermal reference readings between the readings of a set-up, often enough."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.design import move_times, order, schedule
from oed.measurement.measurement import Measurement, Series
from pkm_studies.base.errors import Place
from pkm_studies.resolve import command_ranges, grids
from pkm_studies.study.tables import OrderTable

#: run of thermal reference readings
REFERENCE_RUN = "reference"


@dataclasses.dataclass(frozen=True)
class RouteTiming:
    """A route through the readings, joint speeds (SI) and time of one reading, s."""

    route: order.Route
    speeds: Sequence[float]
    reading: float


def with_reference_readings(
    measurement: Measurement,
    series: Series,
    timing: RouteTiming,
    table: OrderTable,
    every_min: float,
    place: Place,
) -> tuple[Series, float]:
    """The readings in time with reference readings in between; when the last ends, s.

    Raises InputError where the set-up has a reference of its own, or time is too short.
    """
    every = place.key("reference_every_min")
    command = reference_command(measurement, series.setup, table, every_min, place)
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
    place: Place,
) -> Array | None:
    """The reference's command (n_dof,) in a set-up; None for the route's first pose.

    Raises InputError where the set-up has a reference of its own, or the pose is none.
    """
    setup = measurement.setups[name]
    if setup.instrument.reference == "run":
        raise place.key("reference_every_min").error(
            f"the first pose of each run is the reference of {name}",
            "remove it",
            every_min,
        )
    if not table.reference:
        return None
    at, machine = place.key("reference"), measurement.machine
    command, hold, keys = grids.grid_commands(table.reference, machine, at)
    if len(command) != 1:
        raise at.error(
            "the reference is one pose", "give one value for each coordinate"
        )
    if hold is not None:
        command = grids.mid_range(command, hold, machine, setup)
    command_ranges.check_tool_workspace(
        measurement.kinematics, command, keys, at, setup.tool
    )
    command, _ = grids.solve_held(measurement, name, command, hold, at, strict=True)
    return np.asarray(command[0])
