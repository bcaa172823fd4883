"""Commanded poses with a wrong sign, exchanged columns, another unit or another start, and
another program of a fixed length.

A ball bar lets a machine move only where its length hardly changes. A circle at another
height was driven with tilts of its own, and the file has the commands of the planned one:
one coordinate is displaced, and another one follows.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base import Array
from oed.checks.mistakes.moved import (
    FULL_TURN,
    Change,
    Moved,
    SoughtAmount,
    change_column,
    commanded,
    commanded_in_file,
    displaced_trials,
    exchanged,
    inside,
    moved_trials,
    permuted,
    pose_table,
    same,
    shifted,
    turns_freely,
)
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, amount
from oed.dataset import ReadingsColumn, column_meanings
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.model import Coordinate

#: shares of a coordinate's range where an amount is sought first
RANGE_SHARES = (0.003, 0.01, 0.03, 0.1, 0.3)
TURN_STEPS = 24  #: steps of a full turn where it is sought first
#: spread of an amount about where it is sought, over its distance from nothing
RELATIVE_SPREAD = 0.5
RANGE_SLACK = 0.1  #: share of the workspace by which a machine may have stood outside
RELATIVE_STEP = 1e-3  #: step for differences over an amount, over its spread
MAX_STEPS = 12  #: Newton steps to the pose with the same reading
COMMAND_STEP = 1e-5  #: step of a command for differences, SI
#: widths of the workspace outside of it beyond which Newton steps do not come back
MAX_WIDTHS_OUTSIDE = 2.0


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """All commands of the file, of a set-up and of a run with each change undone."""
    measurement = data.session.measurement
    for sentence, change in _changes(data):
        moved = commanded(measurement, change)
        yield from moved_trials(data, "pose", f"{sentence}{{within}}", moved)
    if data.whole:
        return
    for k, coordinate in enumerate(measurement.machine.command):
        for sought in sought_amounts(coordinate):
            yield from _displaced(data, k, sought)
    yield from _programs(data)


def sought_amounts(coordinate: Coordinate) -> Iterator[SoughtAmount]:
    """Amounts by which a coordinate is displaced first."""
    span = coordinate.upper - coordinate.lower
    if turns_freely(coordinate):
        step = FULL_TURN / TURN_STEPS
        spread = RELATIVE_SPREAD * step
        for k in range(1, TURN_STEPS):
            number = k if k <= TURN_STEPS // 2 else k - TURN_STEPS
            yield SoughtAmount(number * step, spread, RELATIVE_STEP * spread, str(k))
    elif np.isfinite(span):
        for share, sign in itertools.product(RANGE_SHARES, (1.0, -1.0)):
            away = share * span
            spread = RELATIVE_SPREAD * away
            yield SoughtAmount(sign * away, spread, RELATIVE_STEP * spread)


def _changes(data: Suspect) -> Iterator[tuple[str, Change]]:
    command = data.session.measurement.machine.command
    names = list(data.columns)
    for k, coordinate in enumerate(command):
        for text, meant in column_meanings(coordinate, data.command[:, k]).items():
            yield text.format(names[k]), change_column(k, meant)
    for j, k in itertools.combinations(range(len(command)), 2):
        if command[j].unit != command[k].unit:
            continue
        order = exchanged(len(command), j, k)
        for pair in itertools.product((1.0, -1.0), repeat=2):
            signs = np.ones(len(command))
            signs[[j, k]] = pair
            first, second = ("-" if sign < 0.0 else "" for sign in pair)
            text = (
                f"the axes of the poses stand otherwise: {names[j]} is {first}{names[k]},"
                f" {names[k]} is {second}{names[j]}"
            )
            if min(pair) > 0.0:
                text = f"the columns {names[j]} and {names[k]} are exchanged"
            yield text, permuted(order, signs)


def _displaced(data: Suspect, k: int, sought: SoughtAmount) -> Iterator[MistakeTrial]:
    """One coordinate of the file's rows, of the teach poses, or of all, by an amount."""
    measurement = data.session.measurement
    taught = any(measurement.setups[s.setup].teach for s in data.session.series)
    wholes = [scope for scope in data.scopes if not scope.is_part]
    for rows in _rows(data, k, sought.spread) if taught else ("file",):

        def moved(by: float, rows: str = rows) -> Moved:
            return commanded(measurement, shifted(k, -by), rows=rows, slack=RANGE_SLACK)

        yield from displaced_trials(
            data,
            "pose" if rows == "file" else "teach",
            partial(_displacement, measurement.machine.command[k], rows),
            moved,
            sought,
            f"{k} {rows}",
            scopes=data.scopes if rows == "file" else wholes,
        )


def _rows(data: Suspect, k: int, spread: float) -> tuple[str, ...]:
    """Which commands may be displaced; not the teach pose where nothing depends on it."""
    change = shifted(k, spread)
    moved = commanded(data.session.measurement, change, rows="teach", slack=RANGE_SLACK)
    table = pose_table(data, moved)
    is_used = table is None or not same(data, table)
    return ("file", "teach", "all") if is_used else ("file",)


def high_or_low(
    coordinate: Coordinate, where: str, amounts: Array, sd: Array
) -> tuple[str, str]:
    """The column of a coordinate somewhere, and how much it is too high or too low."""
    unit = "deg" if coordinate.unit == "rad" else "mm"
    name = ReadingsColumn.of(coordinate.name, coordinate.unit).name
    way = "high" if amounts[0] > 0.0 else "low"
    return f"{name}{where}", f"{amount(abs(amounts[0]), sd[0], unit)} too {way}"


def _displacement(
    coordinate: Coordinate, rows: str, scope: Scope, amounts: Array, sd: Array
) -> str:
    if turns_freely(coordinate) and rows == "file":
        name = ReadingsColumn.of(coordinate.name, coordinate.unit).name
        start = amount(amounts[0], sd[0], "deg")
        return f"{name} starts {start} from where it should{scope.within}"
    where = {
        "file": scope.within,
        "teach": f" of the teach pose{scope.of}",
        "all": f"{scope.within}, and that of the teach pose,",
    }[rows]
    return " is ".join(high_or_low(coordinate, where, amounts, sd))


# -- another program of a fixed length -------------------------------------------------
def _programs(data: Suspect) -> Iterator[MistakeTrial]:
    """Each coordinate displaced in the file, a set-up and a run, with each that follows."""
    command = data.session.measurement.machine.command
    if len(command) > 3 or not np.isfinite(data.length).any():
        return
    straight = [k for k, c in enumerate(command) if not turns_freely(c)]
    for k, follower in itertools.permutations(straight, 2):
        yield from _follower_trials(data, k, follower)
    for follower in straight:
        yield from _constant_joint(data, follower)


def _follower_trials(data: Suspect, k: int, follower: int) -> Iterator[MistakeTrial]:
    measurement = data.session.measurement
    displaced, following = (measurement.machine.command[i] for i in (k, follower))
    other = ReadingsColumn.of(following.name, following.unit).name

    def moved(by: float) -> Moved:
        return program(measurement, k, follower, -by)

    def text(scope: Scope, amounts: Array, sd: Array) -> str:
        away = " is ".join(high_or_low(displaced, scope.within, amounts, sd))
        return f"{away}, with {other} as this program has it: another one was driven"

    for sought in sought_amounts(displaced):
        yield from displaced_trials(
            data,
            "pose",
            text,
            moved,
            sought,
            f"{k} with {follower}",
            scopes=data.scopes,
            is_blind=True,
        )


def _constant_joint(data: Suspect, follower: int) -> Iterator[MistakeTrial]:
    """One coordinate as the instrument's length asks, whatever the file has: it may be
    rounded, or written otherwise.
    """
    measurement = data.session.measurement
    coordinate = measurement.machine.command[follower]
    name = ReadingsColumn.of(coordinate.name, coordinate.unit).name
    moved = program(measurement, follower, follower, 0.0, keeps_length=True)
    sentence = (
        f"{name}{{within}} is not what was driven: it is rounded, or has another unit or"
        " origin, as the length of the instrument asks for other values"
    )
    yield from moved_trials(data, "pose", sentence, moved)


def program(
    measurement: Measurement,
    k: int,
    follower: int,
    amount: float,
    *,
    keeps_length: bool = False,
) -> Moved:
    """Series with one coordinate displaced, SI, and another that follows, so that the
    nominal machine reads the same, or the length that the instrument keeps.
    """

    coordinate = measurement.machine.command[follower]
    room = MAX_WIDTHS_OUTSIDE * (coordinate.upper - coordinate.lower)

    def moved(series: Series) -> Series | None:
        setup = measurement.setups[series.setup]
        length = setup.instrument.fixed_reading
        if length is None or not np.isfinite(series.command).all():
            return None
        goal = _first_channel(measurement, series)
        if keeps_length:
            goal[:] = length(setup.settings)
        rows = commanded_in_file(series, is_taught=setup.teach is not None)
        # the reading that each of these rows has
        reading = np.zeros(len(rows), dtype=np.intp)
        reading[series.index[:, 0]] = np.arange(len(series))
        command = series.command.copy()
        command[rows, k] += amount

        def missing(by: float) -> Array:
            """What readings (n,) lack of the goal where followers change."""
            nearby = command.copy()
            nearby[rows, follower] += by
            return _first_channel(measurement, _at(measurement, series, nearby)) - goal

        for _ in range(MAX_STEPS):
            here = missing(0.0)
            if np.abs(here).max() < 1e-10:
                is_inside = inside(
                    command[rows], measurement.machine, setup.tool, RANGE_SLACK
                )
                return _at(measurement, series, command) if is_inside else None
            change = missing(COMMAND_STEP) - here
            if not np.all(np.abs(change) > 0.0):  # also where a reading is not finite
                return None
            step = -here * COMMAND_STEP / change
            command[rows, follower] += step[reading[rows]]
            # hundreds of steps of kinematics away nothing is read
            value = command[:, follower]
            far = (value < coordinate.lower - room) | (value > coordinate.upper + room)
            if far.any():
                lost = np.flatnonzero(far)
                raise AssemblyError("no command has this reading", lost)
        return None

    return moved


def _at(measurement: Measurement, series: Series, command: Array) -> Series:
    tool = np.array(measurement.setups[series.setup].tool)
    x, q = measurement.kinematics.sent(command, tool)
    return dataclasses.replace(series, q=q, start=x, command=command)


def _first_channel(measurement: Measurement, series: Series) -> Array:
    count = len(measurement.setups[series.setup].instrument.channels)
    y = measurement.readings([series], measurement.nominal)
    return y[::count].copy()
