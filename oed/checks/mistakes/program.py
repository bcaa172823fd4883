"""Another program of a fixed length: one coordinate displaced, another one following.

A ball bar lets a machine move only where its length hardly changes. A circle at another
height was driven with tilts of its own, and the file has the commands of the planned one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Mask
from oed.checks.mistakes.driven import in_file, inside, turns_freely
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import Moved, displaced_trials, on_moved, pose_table
from oed.checks.mistakes.pose import SLACK, STEP, searched_amounts
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, Words, in_scopes
from oed.checks.words import rounded
from oed.dataset.columns import column_name
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.model.machine import Coordinate

#: commands of a machine from which on a length leaves many programs open
MOST_COMMANDS = 3
#: Newton steps to the pose with the same reading, step for differences, closeness, SI
ROUNDS, DIFFERENCE, CLOSE = 12, 1e-5, 1e-10
#: widths of the workspace outside of it beyond which Newton steps do not come back
FAR_OUTSIDE = 2.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each coordinate displaced in the file, a set-up and a run, with each that follows."""
    command = given.session.measurement.machine.command
    if not given.with_amounts or len(command) > MOST_COMMANDS:
        return
    if not np.isfinite(given.length).any():
        return
    straight = [k for k, c in enumerate(command) if not turns_freely(c.lower, c.upper)]
    for k in straight:
        for follower in straight:
            if follower != k:
                yield from _displaced(given, k, follower)
    for follower in straight:
        yield from _constant_joint(given, follower)


def _displaced(given: Given, k: int, follower: int) -> Iterator[MistakeTrial]:
    measurement = given.session.measurement
    displaced, following = (measurement.machine.command[i] for i in (k, follower))

    def moved(by: float) -> Moved:
        return program(measurement, k, follower, -by)

    for searched in searched_amounts(displaced):
        yield from displaced_trials(
            given,
            "pose",
            partial(_words, displaced, following),
            moved,
            (searched.amount, STEP * searched.spread, searched.spread),
            f"{k} with {follower}",
            scopes=given.scopes,
            is_blind=True,
        )


def _constant_joint(given: Given, follower: int) -> Iterator[MistakeTrial]:
    """One coordinate as the instrument's length asks, whatever the file has: it may be
    rounded, or written otherwise.
    """
    measurement = given.session.measurement
    coordinate = measurement.machine.command[follower]
    moved = program(measurement, follower, follower, 0.0, keeps_length=True)
    table = pose_table(given, moved)
    if table is None or np.abs(table.predicted - given.predicted).max() < CLOSE:
        return
    name = column_name(coordinate.name, coordinate.unit)
    sentence = (
        f"{name}{{within}} is not what was driven: it is rounded, or has another unit or"
        " origin, as the length of the instrument asks for other values"
    )
    yield from in_scopes(given.scopes, on_moved(given, "pose", sentence, moved, table))


def _words(displaced: Coordinate, following: Coordinate, scope: Scope) -> Words:
    name, other = (column_name(c.name, c.unit) for c in (displaced, following))
    unit = "deg" if displaced.unit == "rad" else "mm"

    def words(amounts: Array, sd: Array) -> str:
        size, error = (units.number(float(v[0]), unit) for v in (amounts, sd))
        way = "high" if size > 0.0 else "low"
        return (
            f"{name}{scope.within} is {rounded(abs(size), error)} {unit} too {way}, with"
            f" {other} as this program has it: another one was driven"
        )

    return words


def program(
    measurement: Measurement,
    k: int,
    follower: int,
    amount: float,
    *,
    keeps_length: bool = False,
) -> Moved:
    """Series with one coordinate displaced by an amount, SI, and another that follows.

    The nominal machine reads the same as at the commands of the file, or the length that
    the instrument keeps.
    """

    def moved(series: Series) -> Series | None:
        setup = measurement.setups[series.setup]
        length = setup.instrument.fixed_reading
        if length is None or not np.isfinite(series.command).all():
            return None
        goal = _first_channel(measurement, series)
        if keeps_length:
            goal[:] = length(setup.settings)
        return _solved(measurement, series, k, follower, amount, goal)

    return moved


def _solved(
    measurement: Measurement,
    series: Series,
    k: int,
    follower: int,
    amount: float,
    goal: Array,
) -> Series | None:
    """The same, with readings (n,) of the first channel that are a goal."""
    setup = measurement.setups[series.setup]
    rows = in_file(series, is_taught=setup.teach is not None)
    command = series.command.copy()
    command[rows, k] += amount
    place = _place_of_rows(series, rows)
    for _ in range(ROUNDS):
        here = _first_channel(measurement, _at(measurement, series, command)) - goal
        if np.abs(here).max() < CLOSE:
            break
        nearby = command.copy()
        nearby[rows, follower] += DIFFERENCE
        there = _first_channel(measurement, _at(measurement, series, nearby)) - goal
        change = there - here
        if not np.all(np.abs(change) > 0.0):  # also where a reading is not finite
            return None
        step = -here * DIFFERENCE / change
        command[rows, follower] += step[place]
        _check_distance(command, follower, measurement)
    else:
        return None
    if not inside(command[rows], measurement.machine, setup.tool, SLACK):
        return None
    return _at(measurement, series, command)


def _check_distance(command: Array, follower: int, measurement: Measurement) -> None:
    """Raise AssemblyError for commands (m, n_dof) whose follower is far outside.

    The kinematics would follow them from home in hundreds of steps before it gave up.
    """
    coordinate = measurement.machine.command[follower]
    room = FAR_OUTSIDE * (coordinate.upper - coordinate.lower)
    value = command[:, follower]
    is_far = (value < coordinate.lower - room) | (value > coordinate.upper + room)
    if is_far.any():
        raise AssemblyError("no command has this reading", np.flatnonzero(is_far))


def _place_of_rows(series: Series, rows: Mask) -> Array:
    """Number of the reading that each commanded row of the file has."""
    reading = np.zeros(len(series.command), dtype=np.intp)
    reading[series.index[:, 0]] = np.arange(len(series))
    return np.asarray(reading[rows])


def _at(measurement: Measurement, series: Series, command: Array) -> Series:
    tool = np.array(measurement.setups[series.setup].tool)
    x, q = measurement.kinematics.sent(command, tool)
    return dataclasses.replace(series, q=q, start=x, command=command)


def _first_channel(measurement: Measurement, series: Series) -> Array:
    count = len(measurement.setups[series.setup].instrument.channels)
    y = measurement.readings([series], measurement.nominal)
    return y[::count].copy()
