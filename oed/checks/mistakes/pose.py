"""Commanded poses with a wrong sign, exchanged columns, another unit or another start."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.checks.mistakes.driven import (
    Change,
    commanded,
    in_turn,
    of_column,
    permuted,
    scaled,
    shifted,
    turns_freely,
)
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import Moved, on_moved, pose_table, undo_moved
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, PoseTable, Words, in_scopes
from oed.checks.words import rounded
from oed.dataset.columns import column_name
from oed.dataset.notations import notations
from oed.model.machine import Coordinate

#: where an amount is sought first: shares of a coordinate's range, and steps of a turn
SHARES, TURNS = (0.003, 0.01, 0.03, 0.1, 0.3), 24
#: spread of an amount about where it is sought, over its distance from nothing
NEARBY = 0.5
#: share of the workspace by which a machine may have stood outside
SLACK = 0.1
#: step for differences over an amount, over its spread
STEP = 1e-3


def trials(given: Given) -> Iterator[MistakeTrial]:
    """All commands of the file, of a set-up and of a run with each change undone."""
    measurement = given.session.measurement
    for sentence, change in _changes(given):
        moved = commanded(measurement, change)
        table = pose_table(given, moved)
        if table is not None and not _same(given, table):
            on = on_moved(given, "pose", f"{sentence}{{within}}", moved, table)
            yield from in_scopes(given.scopes, on)
    if not given.with_amounts:
        return
    for k, coordinate in enumerate(measurement.machine.command):
        for searched in searched_amounts(coordinate):
            yield from _displaced(given, k, searched)


@dataclasses.dataclass(frozen=True)
class SearchedAmount:
    """An amount where a displacement is sought first, and how far from there, SI.

    basin  of amounts that lead to the same one
    """

    amount: float
    spread: float
    basin: str


def searched_amounts(coordinate: Coordinate) -> Iterator[SearchedAmount]:
    """Amounts by which a coordinate is displaced first."""
    lower, upper = coordinate.lower, coordinate.upper
    if coordinate.unit == "rad" and turns_freely(lower, upper):
        step = 2.0 * np.pi / TURNS
        for k in range(1, TURNS):
            turn = (k if k <= TURNS // 2 else k - TURNS) * step
            yield SearchedAmount(turn, NEARBY * step, str(k))
    elif np.isfinite(upper - lower):
        for share, sign in itertools.product(SHARES, (1.0, -1.0)):
            amount = sign * share * (upper - lower)
            yield SearchedAmount(amount, NEARBY * abs(amount), "")


def _changes(given: Given) -> Iterator[tuple[str, Change]]:
    command = given.session.measurement.machine.command
    names = [column_name(c.name, c.unit) for c in command]
    every = np.vstack([s.command[s.index[:, 0]] for s in given.session.series])
    for k, coordinate in enumerate(command):
        for words, meant in notations(coordinate, every[:, k]).items():
            yield words.format(names[k]), of_column(k, meant)
    for j, k in itertools.combinations(range(len(command)), 2):
        if command[j].unit != command[k].unit:
            continue
        order = list(range(len(command)))
        order[j], order[k] = k, j
        exchanged = permuted(tuple(order))
        yield f"the columns {names[j]} and {names[k]} are exchanged", exchanged
        for signs in ((1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            first, second = ("-" if sign < 0.0 else "" for sign in signs)
            yield (
                f"the axes of the poses stand otherwise: {names[j]} is {first}{names[k]},"
                f" {names[k]} is {second}{names[j]}",
                in_turn(exchanged, scaled(j, signs[0]), scaled(k, signs[1])),
            )


def _same(given: Given, table: PoseTable) -> bool:
    """Whether nothing is read or known otherwise, as after a turn of 360 deg."""
    predicted = np.allclose(table.predicted, given.predicted, rtol=0.0, atol=1e-12)
    return predicted and np.allclose(table.slopes, given.slopes, rtol=1e-9, atol=1e-15)


def _displaced(
    given: Given, k: int, searched: SearchedAmount
) -> Iterator[MistakeTrial]:
    """One coordinate of the file's rows, of the teach poses, or of all, by an amount."""
    amount, spread = searched.amount, searched.spread
    measurement = given.session.measurement
    coordinate = measurement.machine.command[k]
    taught = any(measurement.setups[s.setup].teach for s in given.session.series)
    for rows in _rows(given, k, spread) if taught else ("file",):

        def moved(by: float, rows: str = rows) -> Moved:
            return commanded(measurement, shifted(k, -by), rows=rows, slack=SLACK)

        near = moved(amount + STEP * spread)
        table = pose_table(given, moved(amount), [near], [1.0 / STEP])
        if table is None or _same(given, table):
            continue

        def on(
            scope: Scope,
            rows: str = rows,
            moved: Callable[[float], Moved] = moved,
            table: PoseTable = table,
        ) -> MistakeTrial | None:
            if rows != "file" and scope.is_part:
                return None
            return MistakeTrial(
                kind="pose" if rows == "file" else "teach",
                scope=scope,
                words=_displacement_words(coordinate, rows, scope),
                undo=undo_moved(given, scope, moved),
                amounts=np.array([amount]),
                steps=np.array([STEP * spread]),
                family=f"{k} {rows} {scope.name} {searched.basin}",
                table=table,
                mask=scope.values(given.session),
            )

        yield from in_scopes(given.scopes, on)


def _rows(given: Given, k: int, spread: float) -> tuple[str, ...]:
    """Which commands may be displaced; not the teach pose where nothing depends on it."""
    change = shifted(k, spread)
    moved = commanded(given.session.measurement, change, rows="teach", slack=SLACK)
    table = pose_table(given, moved)
    is_used = table is None or not _same(given, table)
    return ("file", "teach", "all") if is_used else ("file",)


def _displacement_words(coordinate: Coordinate, rows: str, scope: Scope) -> Words:
    name = column_name(coordinate.name, coordinate.unit)
    unit = "deg" if coordinate.unit == "rad" else "mm"
    turns = coordinate.unit == "rad" and turns_freely(
        coordinate.lower, coordinate.upper
    )

    def words(amounts: Array, sd: Array) -> str:
        size, error = (units.number(float(v[0]), unit) for v in (amounts, sd))
        if turns and rows == "file":
            degrees = rounded(size, error)
            return f"{name} starts {degrees} deg from where it should{scope.within}"
        way = "high" if size > 0.0 else "low"
        number = f"{rounded(abs(size), error)} {unit} too {way}"
        if rows == "teach":
            return f"{name} of the teach pose{scope.of} is {number}"
        with_teach = ", and that of the teach pose," if rows == "all" else ""
        return f"{name}{scope.within}{with_teach} is {number}"

    return words
