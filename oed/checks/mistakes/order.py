"""Readings in another order than their poses: reversed, late, of another run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, members, plain

#: rows by which readings are late, where those pushed out at an end are lost
SHIFTS = (1, -1, 2, -2, 3, -3)
#: readings of a run up to which every shift is tried that puts the last ones first
MOST_TURNED = 60


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings reversed and shifted, in each run, in one of them, and in the file."""
    for subject, where, scope, groups in _groupings(given):
        yield from _backward(given, subject, scope, groups)
        for shift in SHIFTS:
            yield from _late(given, subject, where, scope, groups, shift)
        if scope.level == "run" or scope.name == "":
            yield from _turned(given, subject, where, scope, groups)
    for scope in given.parts:
        for shift in (1, -1):
            subject = f"the readings{scope.of}"
            yield from _late(given, subject, "", scope, [scope.readings], shift)
    yield from _exchanged_runs(given)
    yield from _exchanged_setups(given)


def _groupings(
    given: Given,
) -> Iterator[tuple[str, str, Scope, list[Index]]]:
    """Whose readings, where they stand, their scope, and groups in which to reorder."""
    file = given.file
    runs = [run.readings for run in given.runs]
    yield "the readings of each run", "in each run ", file, runs
    for scope in given.scopes:
        if len(runs) == 1 and scope.level == "file":
            continue
        subject = (
            f"the readings{scope.of}" if scope.name else "the readings of the file"
        )
        where = "" if scope.name else "in the file "
        yield subject, where, scope, [scope.readings]


def _backward(
    given: Given, subject: str, scope: Scope, groups: list[Index]
) -> Iterator[MistakeTrial]:
    order = _reordered(given, groups, lambda rows: rows[::-1])
    sentence = f"{subject} are in reversed order"
    yield from _reordering(given, scope, sentence, order)


def _late(
    given: Given,
    subject: str,
    where: str,
    scope: Scope,
    groups: list[Index],
    shift: int,
) -> Iterator[MistakeTrial]:
    """Readings that stand some rows too late, put back; those pushed out are lost."""
    if min(len(rows) for rows in groups) <= 2 * abs(shift):
        return
    order = _reordered(given, groups, _roll(-shift))
    lost = [rows[-shift:] if shift > 0 else rows[:-shift] for rows in groups]
    count = f"{abs(shift)} row{'s' if abs(shift) > 1 else ''}"
    way = "late" if shift > 0 else "early"
    subject = "the readings" if where else subject
    sentence = f"{subject} stand {where}{count} too {way}"
    yield from _reordering(given, scope, sentence, order, np.concatenate(lost))


def _turned(
    given: Given, subject: str, where: str, scope: Scope, groups: list[Index]
) -> Iterator[MistakeTrial]:
    """Readings that stand some rows too late, the last ones first."""
    sizes = [len(rows) for rows in groups]
    if max(sizes) > MOST_TURNED:
        return
    subject = "the readings" if where else subject
    for shift in range(1, min(sizes)):
        order = _reordered(given, groups, _roll(-shift))
        late, way = min((shift, "late"), (max(sizes) - shift, "early"))
        count = f"{late} row{'s' if late > 1 else ''}"
        sentence = (
            f"{subject} stand {where}{count} too {way}, with those pushed out at the other"
            " end"
        )
        yield from _reordering(given, scope, sentence, order)


def _roll(rows: int) -> Callable[[Index], Index]:
    return lambda readings: np.roll(readings, rows)


def _exchanged_runs(given: Given) -> Iterator[MistakeTrial]:
    """The readings of two runs of one length exchanged, and of all runs turned round."""
    for one, other in itertools.combinations(given.runs, 2):
        if len(one.readings) != len(other.readings):
            continue
        order = _every(given)
        order[one.readings], order[other.readings] = other.readings, one.readings
        both = Scope("run", f"{one.name} and {other.name}", one.readings)
        names = " and ".join(s.name.removeprefix("run ") for s in (one, other))
        sentence = f"the readings of the runs {names} are exchanged"
        yield from _reordering(given, both, sentence, order)
    sizes = {len(run.readings) for run in given.runs}
    if len(given.runs) < 3 or len(sizes) > 1:
        return
    for step, way in ((1, "next"), (-1, "previous")):
        order = _every(given)
        turned = [*given.runs[step:], *given.runs[:step]]
        for run, source in zip(given.runs, turned, strict=True):
            order[run.readings] = source.readings
        sentence = f"the readings of each run stand under the {way} run"
        yield from _reordering(given, given.file, sentence, order)


def _exchanged_setups(given: Given) -> Iterator[MistakeTrial]:
    setups = [scope for scope in given.scopes if scope.level == "set-up"]
    for one, other in itertools.combinations(setups, 2):
        if len(one.readings) != len(other.readings):
            continue
        order = _every(given)
        order[one.readings], order[other.readings] = other.readings, one.readings
        names = " and ".join(s.name.removeprefix("set-up ") for s in (one, other))
        sentence = f"the readings of the set-ups {names} are exchanged"
        yield from _reordering(given, one, sentence, order)


def _every(given: Given) -> Index:
    return np.arange(1 + int(given.session.reading_of_value[-1]), dtype=np.intp)


def _reordered(
    given: Given, groups: Sequence[Index], turn: Callable[[Index], Index]
) -> Index:
    """Readings to take, by number, with those of each group turned."""
    order = _every(given)
    for rows in groups:
        order[rows] = turn(rows)
    return order


def _reordering(
    given: Given,
    scope: Scope,
    sentence: str,
    order: Index,
    lost: Index | None = None,
) -> Iterator[MistakeTrial]:
    """The session with its readings in another order, poses in place.

    Nothing where readings of other channels would meet, or nothing changes.
    """
    session = given.session
    taken = members(session, order)
    same = len(taken) == len(session) and np.array_equal(
        given.channel[taken], given.channel
    )
    if not same or not given.shown.all():
        return
    y: Array = session.y[taken]
    missing = None
    if lost is not None:
        missing = np.isin(session.reading_of_value, lost)
    moved = y != session.y if missing is None else (y != session.y) & ~missing
    if not moved.any():
        return
    dropped = [] if lost is None else [int(k) for k in lost]
    changed = session.with_y(y)
    yield MistakeTrial(
        kind="order",
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [changed.without(dropped) if dropped else changed],
        y=y,
        missing=missing,
    )
