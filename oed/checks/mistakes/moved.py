"""Sessions whose readings were taken at other poses, in other set-ups, or otherwise."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from oed.base import Array, Index, Mask
from oed.checks.fit import CANNOT_BE, NO_AMOUNTS
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, PoseTable, mistakes_of_scopes
from oed.checks.session import SessionReadings
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.model import Coordinate, Machine

#: a series as it was read; None where it cannot have been
Moved = Callable[[Series], Series | None]
Result = TypeVar("Result")

#: what the name of a set-up ends in that some readings have anew
AGAIN_SUFFIX = " again"


@dataclasses.dataclass(frozen=True)
class SoughtAmount:
    """Where an amount is sought first, and its spread about there, SI."""

    amount: float
    spread: float
    step: float  #: for differences
    basin: str = ""  #: of amounts that lead to the same one


def moved_trials(
    data: Suspect,
    kind: str,
    sentence: str,
    moved: Moved,
    seldom: float = 0.0,
    scopes: Sequence[Scope] | None = None,
) -> Iterator[MistakeTrial]:
    """Readings taken at moved poses, in the file, its parts, or some scopes."""
    some = data.scopes if scopes is None else scopes

    def text(scope: Scope, amounts: Array, sd: Array) -> str:
        return sentence.format(of=scope.of, within=scope.within)

    yield from displaced_trials(
        data, kind, text, lambda by: moved, None, scopes=some, seldom=seldom
    )


def displaced_trials(
    data: Suspect,
    kind: str,
    text: Callable[[Scope, Array, Array], str],
    moved: Callable[[float], Moved],
    sought: SoughtAmount | None,
    family: str = "",
    *,
    scopes: Sequence[Scope],
    is_blind: bool = False,
    seldom: float = 0.0,
) -> Iterator[MistakeTrial]:
    """Readings of some scopes taken at poses moved by an amount, if there is one; none
    where nothing is read otherwise.
    """
    amounts, steps = NO_AMOUNTS, NO_AMOUNTS
    if sought is None:
        table = pose_table(data, moved(0.0))
    else:
        amounts, steps = np.array([sought.amount]), np.array([sought.step])
        near = moved(sought.amount + sought.step)
        spread = sought.spread / sought.step
        table = pose_table(data, moved(sought.amount), near, spread)
        family = f"{family} {sought.basin}"
    if table is None or same(data, table):
        return

    def on(scope: Scope) -> MistakeTrial:
        def undo(amounts: Array) -> list[SessionReadings]:
            displaced = moved(float(amounts.sum()))
            return [with_moved(data.session, scope.readings, displaced)]

        return MistakeTrial(
            kind=kind,
            scope=scope,
            text=partial(text, scope),
            change=undo,
            amounts=amounts,
            steps=steps,
            is_blind=is_blind,
            log_prior=0.0 if scope.level == "file" else seldom,
            family=f"{family} {scope.name}" if family else "",
            table=table,
        )

    yield from mistakes_of_scopes(scopes, on)


def same(data: Suspect, table: PoseTable) -> bool:
    """Whether nothing is read or known otherwise, as after a turn of 360 deg."""
    predicted = np.allclose(table.predicted, data.predicted, rtol=0.0, atol=1e-12)
    return predicted and np.allclose(table.slopes, data.slopes, rtol=1e-9, atol=1e-15)


def readings_by_run(series: Series) -> list[Index]:
    """Readings of each run of a series, by number in it."""
    return [np.flatnonzero(series.run == name) for name in dict.fromkeys(series.run)]


def moved_rows(series: Series, moved: Moved) -> tuple[Index, Series] | None:
    """The reachable runs of a series, readings by number, as moved; None without."""
    every = np.arange(len(series), dtype=np.intp)
    try:
        whole = moved(series)
    except AssemblyError as error:
        rows = _reached(series, error.indices)
        part = _try(series.take(rows), moved) if rows.size else None
        return None if part is None else (rows, part)
    except CANNOT_BE:
        return None
    return None if whole is None else (every, whole)


def _reached(series: Series, lost: Index) -> Index:
    """Readings of the runs in which no pose is lost."""
    is_lost = np.isin(series.index, lost)
    runs = [rows for rows in readings_by_run(series) if not is_lost[rows].any()]
    return np.concatenate(runs) if runs else np.zeros(0, dtype=np.intp)


def _try(series: Series, of: Callable[[Series], Result | None]) -> Result | None:
    """What a series gives, as moved or as read; None where it cannot be."""
    try:
        return of(series)
    except CANNOT_BE:
        return None


def pose_table(
    data: Suspect, moved: Moved, near: Moved | None = None, spread: float = 1.0
) -> PoseTable | None:
    """What the nominal machine reads of moved series; None where none is reached."""
    session, measurement = data.session, data.session.measurement
    theta = measurement.nominal if data.at is None else data.at.theta
    predicted = np.full(len(session), np.nan)
    slopes = np.full(data.slopes.shape, np.nan)
    by_amount = np.zeros((len(session), 0 if near is None else 1))
    for series, span in zip(session.series, session.spans, strict=True):
        count = session.channel_count(series.setup)
        reached = moved_rows(series, moved)
        if reached is None:
            continue
        values = _try(reached[1], lambda taken: data.linear([taken]))
        if values is None:
            continue
        rows = reached[0]
        places = span.start + (rows[:, None] * count + np.arange(count)).ravel()
        predicted[places], slopes[places] = values
        other = None if near is None else _try(series.take(rows), near)
        if other is not None:
            both = [measurement.try_readings([s], theta) for s in (reached[1], other)]
            by_amount[places, 0] = np.nan_to_num(both[1] - both[0]) * spread
    return (
        None if np.isnan(predicted).all() else PoseTable(predicted, slopes, by_amount)
    )


def mounted_again(
    measurement: Measurement,
    setups: Iterable[str],
    changed: Callable[[Setup], Mapping[str, Any]],
) -> Measurement:
    """The measurement with some set-ups once more, with another name and fields."""
    again = []
    for name in setups:
        one = measurement.setups[name]
        again.append(dataclasses.replace(one, name=name + AGAIN_SUFFIX, **changed(one)))
    return measurement.with_setups([*measurement.setups.values(), *again])


def with_moved(
    session: SessionReadings, readings: Index, moved: Moved
) -> SessionReadings:
    """The session with some readings' series moved. Raises AssemblyError."""
    parts: list[tuple[Series, Index]] = []
    first = 0
    for series in session.series:
        numbers = first + np.arange(len(series), dtype=np.intp)
        first += len(series)
        is_moved = np.isin(numbers, readings)
        if not is_moved.all():
            parts.append((series.take(np.flatnonzero(~is_moved)), numbers[~is_moved]))
        if is_moved.any():
            taken = series if is_moved.all() else series.take(np.flatnonzero(is_moved))
            changed = moved(taken)
            if changed is None:
                raise AssemblyError("a pose cannot be reached", numbers[is_moved])
            parts.append((changed, numbers[is_moved]))
    return _join_parts(session, parts)


def _join_parts(
    session: SessionReadings, parts: list[tuple[Series, Index]]
) -> SessionReadings:
    """A session of series with the numbers of their readings in another one."""
    number = session.reading_of_value
    places = [np.flatnonzero(np.isin(number, numbers)) for _, numbers in parts]
    frames = []
    for (series, _), rows in zip(parts, places, strict=True):
        frames.append(session.values.iloc[rows].assign(setup=series.setup))
    return dataclasses.replace(
        session,
        series=tuple(series for series, _ in parts),
        y=session.y[np.concatenate(places)],
        values=pd.concat(frames, ignore_index=True),
    )


# Series driven to other poses: other commands in the file's rows, other joints.

FULL_TURN = 2.0 * np.pi  #: a full turn, rad
RANGE_TOLERANCE = 1e-9  #: share of a coordinate's range that rounding may exceed
Change = Callable[[Array], Array]  #: commands or joints (n, k) in place of others


def commanded(
    measurement: Measurement, change: Change, *, rows: str = "file", slack: float = 0.0
) -> Moved:
    """Change the commands (n, n_dof) of a series that recorded them.

    rows   `file` for those in the file's rows, `teach` for the teach pose, `all`
    slack  share of a range by which a machine may have stood outside the workspace
    """
    machine = measurement.machine

    def moved(series: Series) -> Series | None:
        setup = measurement.setups[series.setup]
        if not np.isfinite(series.command).all():
            return None
        changed = _rows(series, rows, is_taught=setup.teach is not None)
        if not changed.any():
            return None
        command = series.command.copy()
        command[changed] = wrapped(change(command[changed]), machine)
        if not inside(command[changed], machine, setup.tool, slack):
            return None
        x, q = measurement.kinematics.sent(command, np.array(setup.tool))
        return dataclasses.replace(series, q=q, start=x, command=command)

    return moved


def inside(
    command: Array, machine: Machine, tool: Sequence[float], slack: float
) -> bool:
    """Whether no command is outside the workspace by more than a share of it."""
    for value, coordinate in zip(command.T, machine.workspace(tool), strict=True):
        span = coordinate.upper - coordinate.lower
        room = (slack + RANGE_TOLERANCE) * span if np.isfinite(span) else 0.0
        below, above = coordinate.lower - value.min(), value.max() - coordinate.upper
        if max(below, above) > room:
            return False
    return True


def _rows(series: Series, rows: str, *, is_taught: bool) -> Mask:
    """Poses (m,) that are commanded in the file's rows, the teach pose, or all."""
    of_file = commanded_in_file(series, is_taught=is_taught)
    if rows == "teach":
        return ~of_file
    return of_file if rows == "file" else np.ones_like(of_file)


def commanded_in_file(series: Series, *, is_taught: bool) -> Mask:
    """Poses (m,) that are commanded in the file's rows."""
    of_file = np.ones(len(series.command), dtype=bool)
    if is_taught:
        of_file[:] = False
        of_file[series.index[:, 0]] = True
    return of_file


def jointed(measurement: Measurement, change: Change) -> Moved:
    """Series whose joints (m, nq) are changed; their poses are followed from home."""
    kinematics = measurement.kinematics

    def moved(series: Series) -> Series | None:
        q = change(series.q)
        x = kinematics.start_poses(q, patient=False)
        return dataclasses.replace(series, q=q, start=x)

    return moved


def wrapped(command: Array, machine: Machine) -> Array:
    """Commands (n, n_dof) with angles that turn freely brought into their range."""
    turned = command.copy()
    for k, coordinate in enumerate(machine.command):
        if turns_freely(coordinate):
            turns = np.floor((turned[:, k] - coordinate.lower) / FULL_TURN)
            turned[:, k] -= FULL_TURN * turns
    return turned


def turns_freely(coordinate: Coordinate) -> bool:
    """Whether it is an angle whose range is a full turn."""
    span = coordinate.upper - coordinate.lower
    is_turn = np.isfinite(span) and span >= FULL_TURN * (1.0 - RANGE_TOLERANCE)
    return coordinate.unit == "rad" and bool(is_turn)


def change_column(k: int, meant: Change) -> Change:
    """Column k (n,) changed. NaN, which is no pose, raises ValueError later on."""

    def change(values: Array) -> Array:
        changed = values.copy()
        changed[:, k] = meant(values[:, k])
        return changed

    return change


def shifted(k: int, amount: float) -> Change:
    """Column k plus an amount, SI."""
    return change_column(k, lambda values: values + amount)


def exchanged(count: int, one: int, other: int) -> tuple[int, ...]:
    """The order of some columns with two of them exchanged."""
    order = list(range(count))
    order[one], order[other] = other, one
    return tuple(order)


def permuted(order: Sequence[int], signs: ArrayLike = 1.0) -> Change:
    """Columns in another order, with signs."""
    return lambda values: values[:, list(order)] * np.asarray(signs)
