"""Commanded poses with a wrong sign, exchanged columns, another unit or another start."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.checks.mistakes.driven import (
    Change,
    commanded,
    exchanged,
    in_turn,
    of_column,
    permuted,
    scaled,
    shifted,
    turns_freely,
)
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import (
    Moved,
    displaced_trials,
    moved_trials,
    pose_table,
    same,
)
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, Words
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
        yield from moved_trials(given, "pose", f"{sentence}{{within}}", moved)
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
    names = list(given.columns)
    for k, coordinate in enumerate(command):
        for words, meant in notations(coordinate, given.command[:, k]).items():
            yield words.format(names[k]), of_column(k, meant)
    for j, k in itertools.combinations(range(len(command)), 2):
        if command[j].unit != command[k].unit:
            continue
        turned = permuted(exchanged(len(command), j, k))
        yield f"the columns {names[j]} and {names[k]} are exchanged", turned
        for signs in ((1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            first, second = ("-" if sign < 0.0 else "" for sign in signs)
            yield (
                f"the axes of the poses stand otherwise: {names[j]} is {first}{names[k]},"
                f" {names[k]} is {second}{names[j]}",
                in_turn(turned, scaled(j, signs[0]), scaled(k, signs[1])),
            )


def _displaced(
    given: Given, k: int, searched: SearchedAmount
) -> Iterator[MistakeTrial]:
    """One coordinate of the file's rows, of the teach poses, or of all, by an amount."""
    measurement, spread = given.session.measurement, searched.spread
    taught = any(measurement.setups[s.setup].teach for s in given.session.series)
    wholes = [scope for scope in given.scopes if not scope.is_part]
    for rows in _rows(given, k, spread) if taught else ("file",):

        def moved(by: float, rows: str = rows) -> Moved:
            return commanded(measurement, shifted(k, -by), rows=rows, slack=SLACK)

        yield from displaced_trials(
            given,
            "pose" if rows == "file" else "teach",
            partial(_displacement_words, measurement.machine.command[k], rows),
            moved,
            (searched.amount, STEP * spread, spread),
            f"{k} {rows} {searched.basin}",
            scopes=given.scopes if rows == "file" else wholes,
        )


def _rows(given: Given, k: int, spread: float) -> tuple[str, ...]:
    """Which commands may be displaced; not the teach pose where nothing depends on it."""
    change = shifted(k, spread)
    moved = commanded(given.session.measurement, change, rows="teach", slack=SLACK)
    table = pose_table(given, moved)
    is_used = table is None or not same(given, table)
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
