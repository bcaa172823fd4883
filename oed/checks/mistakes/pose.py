"""Commanded poses with a wrong sign, exchanged columns, another unit or another start, and
another program of a fixed length.

A ball bar lets a machine move only where its length hardly changes. A circle at another
height was driven with tilts of its own, and the file has the commands of the planned one:
one coordinate is displaced, and another one follows.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base import Array, Mask
from oed.checks.mistakes.driven import (
    Change,
    commanded,
    exchanged,
    in_file,
    inside,
    of_column,
    permuted,
    shifted,
    turns_freely,
)
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import (
    Moved,
    SoughtAmount,
    displaced_trials,
    moved_trials,
    pose_table,
    same,
)
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, amount
from oed.dataset.columns import column_name
from oed.dataset.notations import notations
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.model import Coordinate

#: where an amount is sought first: shares of a coordinate's range, and steps of a turn
SHARES, TURNS = (0.003, 0.01, 0.03, 0.1, 0.3), 24
#: spread of an amount about where it is sought, over its distance from nothing
NEARBY = 0.5
#: share of the workspace by which a machine may have stood outside
SLACK = 0.1
#: step for differences over an amount, over its spread
STEP = 1e-3
#: commands of a machine from which on a length leaves many programs open
MOST_COMMANDS = 3
#: Newton steps to the pose with the same reading, step for differences, closeness, SI
ROUNDS, DIFFERENCE, CLOSE = 12, 1e-5, 1e-10
#: widths of the workspace outside of it beyond which Newton steps do not come back
FAR_OUTSIDE = 2.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """All commands of the file, of a set-up and of a run with each change undone."""
    measurement = given.session.measurement
    for sentence, change in _changes(given):
        moved = commanded(measurement, change)
        yield from moved_trials(given, "pose", f"{sentence}{{within}}", moved)
    if not given.with_amounts:
        return
    for k, coordinate in enumerate(measurement.machine.command):
        for sought in sought_amounts(coordinate):
            yield from _displaced(given, k, sought)
    yield from _programs(given)


def sought_amounts(coordinate: Coordinate) -> Iterator[SoughtAmount]:
    """Amounts by which a coordinate is displaced first."""
    lower, upper = coordinate.lower, coordinate.upper
    if _turns(coordinate):
        spread = NEARBY * 2.0 * np.pi / TURNS
        for k in range(1, TURNS):
            turn = (k if k <= TURNS // 2 else k - TURNS) * 2.0 * np.pi / TURNS
            yield SoughtAmount(turn, spread, STEP * spread, str(k))
    elif np.isfinite(upper - lower):
        for share, sign in itertools.product(SHARES, (1.0, -1.0)):
            away = share * (upper - lower)
            spread = NEARBY * away
            yield SoughtAmount(sign * away, spread, STEP * spread)


def _turns(coordinate: Coordinate) -> bool:
    ends = coordinate.lower, coordinate.upper
    return coordinate.unit == "rad" and turns_freely(*ends)


def _changes(given: Given) -> Iterator[tuple[str, Change]]:
    command = given.session.measurement.machine.command
    names = list(given.columns)
    for k, coordinate in enumerate(command):
        for words, meant in notations(coordinate, given.command[:, k]).items():
            yield words.format(names[k]), of_column(k, meant)
    for j, k in itertools.combinations(range(len(command)), 2):
        if command[j].unit != command[k].unit:
            continue
        order = exchanged(len(command), j, k)
        for pair in itertools.product((1.0, -1.0), repeat=2):
            signs = np.ones(len(command))
            signs[[j, k]] = pair
            first, second = ("-" if sign < 0.0 else "" for sign in pair)
            words = (
                f"the axes of the poses stand otherwise: {names[j]} is {first}{names[k]},"
                f" {names[k]} is {second}{names[j]}"
            )
            if min(pair) > 0.0:
                words = f"the columns {names[j]} and {names[k]} are exchanged"
            yield words, permuted(order, signs)


def _displaced(given: Given, k: int, sought: SoughtAmount) -> Iterator[MistakeTrial]:
    """One coordinate of the file's rows, of the teach poses, or of all, by an amount."""
    measurement = given.session.measurement
    taught = any(measurement.setups[s.setup].teach for s in given.session.series)
    wholes = [scope for scope in given.scopes if not scope.is_part]
    for rows in _rows(given, k, sought.spread) if taught else ("file",):

        def moved(by: float, rows: str = rows) -> Moved:
            return commanded(measurement, shifted(k, -by), rows=rows, slack=SLACK)

        yield from displaced_trials(
            given,
            "pose" if rows == "file" else "teach",
            partial(_displacement, measurement.machine.command[k], rows),
            moved,
            sought,
            f"{k} {rows}",
            scopes=given.scopes if rows == "file" else wholes,
        )


def _rows(given: Given, k: int, spread: float) -> tuple[str, ...]:
    """Which commands may be displaced; not the teach pose where nothing depends on it."""
    change = shifted(k, spread)
    moved = commanded(given.session.measurement, change, rows="teach", slack=SLACK)
    table = pose_table(given, moved)
    is_used = table is None or not same(given, table)
    return ("file", "teach", "all") if is_used else ("file",)


def high_or_low(
    coordinate: Coordinate, where: str, amounts: Array, sd: Array
) -> tuple[str, str]:
    """The column of a coordinate somewhere, and how much it is too high or too low."""
    unit = "deg" if coordinate.unit == "rad" else "mm"
    name = column_name(coordinate.name, coordinate.unit)
    way = "high" if amounts[0] > 0.0 else "low"
    return f"{name}{where}", f"{amount(abs(amounts[0]), sd[0], unit)} too {way}"


def _displacement(
    coordinate: Coordinate, rows: str, scope: Scope, amounts: Array, sd: Array
) -> str:
    if _turns(coordinate) and rows == "file":
        name = column_name(coordinate.name, coordinate.unit)
        start = amount(amounts[0], sd[0], "deg")
        return f"{name} starts {start} from where it should{scope.within}"
    where = {
        "file": scope.within,
        "teach": f" of the teach pose{scope.of}",
        "all": f"{scope.within}, and that of the teach pose,",
    }[rows]
    return " is ".join(high_or_low(coordinate, where, amounts, sd))


# -- another program of a fixed length -------------------------------------------------


def _programs(given: Given) -> Iterator[MistakeTrial]:
    """Each coordinate displaced in the file, a set-up and a run, with each that follows."""
    command = given.session.measurement.machine.command
    if len(command) > MOST_COMMANDS or not np.isfinite(given.length).any():
        return
    straight = [k for k, c in enumerate(command) if not turns_freely(c.lower, c.upper)]
    for k, follower in itertools.permutations(straight, 2):
        yield from _with_follower(given, k, follower)
    for follower in straight:
        yield from _constant_joint(given, follower)


def _with_follower(given: Given, k: int, follower: int) -> Iterator[MistakeTrial]:
    measurement = given.session.measurement
    displaced, following = (measurement.machine.command[i] for i in (k, follower))
    other = column_name(following.name, following.unit)

    def moved(by: float) -> Moved:
        return program(measurement, k, follower, -by)

    def words(scope: Scope, amounts: Array, sd: Array) -> str:
        away = " is ".join(high_or_low(displaced, scope.within, amounts, sd))
        return f"{away}, with {other} as this program has it: another one was driven"

    for sought in sought_amounts(displaced):
        yield from displaced_trials(
            given,
            "pose",
            words,
            moved,
            sought,
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
    name = column_name(coordinate.name, coordinate.unit)
    moved = program(measurement, follower, follower, 0.0, keeps_length=True)
    sentence = (
        f"{name}{{within}} is not what was driven: it is rounded, or has another unit or"
        " origin, as the length of the instrument asks for other values"
    )
    yield from moved_trials(given, "pose", sentence, moved)


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
