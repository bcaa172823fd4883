"""Readings in another order than their poses: reversed, late, of another run."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from oed.base import Array, Index
from oed.checks.mistakes.moved import exchanged
from oed.checks.mistakes.suspect import Scope, Suspect, several_runs
from oed.checks.mistakes.trial import (
    MistakeTrial,
    members,
    mistakes_of_scopes,
    value_trial,
)

#: rows by which readings are late, where those pushed out at an end are lost
SHIFTS = (1, -1, 2, -2, 3, -3)
Turn = Callable[[Index], Index]  #: readings of a group in another order
#: orders of readings that were taken backward, in words
BACKWARD: dict[str, Turn] = {
    "reversed order": lambda rows: rows[::-1],
    "reversed order after the first": lambda rows: np.append(rows[:1], rows[:0:-1]),
}


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Readings reversed and shifted, in each run, in one of them, and in the file."""
    for text, turn in {**BACKWARD, **_column_orders(data)}.items():
        yield from mistakes_of_scopes(
            data.sequential, partial(_turned_round, text, turn)
        )
    for shift in SHIFTS:
        parts = data.parts if abs(shift) == 1 else []
        yield from mistakes_of_scopes([*data.sequential, *parts], partial(_late, shift))
    for scope in data.sequential:
        if scope.level != "set-up":
            yield from filter(None, _turned(scope))
    yield from filter(None, itertools.chain(_interleaved(data), _relabelled(data)))


def _column_orders(data: Suspect) -> dict[str, Turn]:
    """Orders of rows by a column: as a directory or a spreadsheet sorts them, and those
    of a meander, whose lines are those in which a command stays.
    """
    number = data.session.values["order"].to_numpy()[data.session.firsts]
    columns = {n: v for n, v in data.columns.items() if np.isfinite(v).all()}
    turns: dict[str, Turn] = {}
    for name, values in {"number": number, **columns}.items():
        key = np.round(values, 6)
        as_text = np.array([f"{value:g}" for value in key])
        text = f"the order of their {name}"
        turns[f"{text} as text (1, 10, 2, ...)"] = partial(_unsorted, as_text)
        turns[text] = partial(_unsorted, key)
        for number_of_line, first in enumerate(("first", "second")):
            text = f"the order of a meander: every other line of one {name} backward"
            turns[f"{text}, from the {first} on"] = partial(
                _turn_lines, key, number_of_line
            )
    return turns


def _unsorted(key: Array, rows: Index) -> Index:
    """Readings that belong to rows where they stand sorted by a key (n,)."""
    sources = np.empty_like(rows)
    sources[np.argsort(key[rows], kind="stable")] = rows
    return sources


def _turn_lines(key: Array, first: int, rows: Index) -> Index:
    """Rows with every other line of one key (n,) turned round, where there are several."""
    lines = np.split(rows, np.flatnonzero(np.diff(key[rows])) + 1)
    if len(lines) == 1:
        return rows
    return np.concatenate(
        [line[:: -1 if k % 2 == first else 1] for k, line in enumerate(lines)]
    )


def _turned_round(text: str, turn: Turn, scope: Scope) -> MistakeTrial | None:
    sentence = f"the readings{scope.of or ' of the file'} are in {text}"
    return _reordering(scope, sentence, _reordered(scope, turn))


def _late(shift: int, scope: Scope) -> MistakeTrial | None:
    """Readings that stand some rows too late, put back; those pushed out are lost."""
    groups = [part.readings for part in scope.sequences]
    if min(len(rows) for rows in groups) <= 2 * abs(shift):
        return None
    order = _reordered(scope, partial(np.roll, shift=-shift))
    lost = [rows[-shift:] if shift > 0 else rows[:-shift] for rows in groups]
    return _reordering(scope, _stand(scope, shift), order, np.concatenate(lost))


def _stand(scope: Scope, shift: int) -> str:
    """That readings stand some rows from their place."""
    of, where = scope.of, ""
    if scope.each or not scope.name:
        of, where = "", f" in {scope.name or 'the file'}"
    count = f"{abs(shift)} row{'s' if abs(shift) > 1 else ''}"
    way = "late" if shift > 0 else "early"
    return f"the readings{of} stand{where} {count} too {way}"


def _turned(scope: Scope) -> Iterator[MistakeTrial | None]:
    """Readings that stand some rows too late, the last ones first."""
    sizes = [len(part.readings) for part in scope.sequences]
    if max(sizes) > 60:
        return
    for shift in range(1, min(sizes)):
        order = _reordered(scope, partial(np.roll, shift=-shift))
        least = min(shift, shift - max(sizes), key=abs)
        pushed_out = f"{_stand(scope, least)}, with those pushed out at the other end"
        yield _reordering(scope, pushed_out, order)


def _interleaved(data: Suspect) -> Iterator[MistakeTrial | None]:
    """Readings taken point by point of several runs that stand run by run, or reversely."""
    pairs = [several_runs(two) for two in itertools.pairwise(data.runs)]
    blocks = {scope.readings.tobytes(): scope for scope in [*pairs, *data.scopes]}
    for scope in blocks.values():
        groups = [run.readings for run in scope.runs]
        count = len(groups)
        if count < 2 or len({len(rows) for rows in groups}) > 1:
            continue
        places = np.concatenate(groups)
        for taken, stand, shape in (
            ("point by point", "run by run", (-1, count)),
            ("run by run", "point by point", (count, -1)),
        ):
            order = _every(data)
            order[places] = places.reshape(shape).T.ravel()
            sentence = (
                f"the readings{scope.of} are interleaved: taken {taken} of {count} runs,"
                f" they stand {stand}"
            )
            yield _reordering(scope, sentence, order)


def _relabelled(data: Suspect) -> Iterator[MistakeTrial | None]:
    """Readings of runs, or set-ups, of one length under the names of others: two, or any."""
    by_size: dict[tuple[str, int], list[Scope]] = {}
    setups = [scope for scope in data.scopes if scope.level == "set-up"]
    for part in [*data.runs, *setups]:
        by_size.setdefault((part.level, len(part.readings)), []).append(part)
    for runs in by_size.values():
        count = len(runs)
        pairs = [
            exchanged(count, *two) for two in itertools.combinations(range(count), 2)
        ]
        others = [(*range(1, count), 0), (count - 1, *range(count - 1))]
        if count <= 5:
            others = list(itertools.permutations(range(count)))
        for sources in dict.fromkeys([*pairs, *others]):
            yield _relabelled_runs(runs, sources)


def _relabelled_runs(
    parts: Sequence[Scope], sources: Sequence[int]
) -> MistakeTrial | None:
    """Each run, or set-up, with the readings that stand under another one."""
    count = len(parts)
    level = parts[0].level
    moved = [k for k in range(count) if sources[k] != k]
    if not moved:
        return None
    order = _every(parts[0].data)
    for part, source in zip(parts, sources, strict=True):
        order[part.readings] = parts[source].readings
    names = [part.name.removeprefix(f"{level} ") for part in parts]
    sentence = f"the readings of the {level}s stand under other names: " + ", ".join(
        f"those of {names[k]} under {names[sources[k]]}" for k in moved
    )
    steps = {(sources[k] - k) % count for k in range(count)}
    if len(moved) == 2:
        both = " and ".join(names[k] for k in moved)
        sentence = f"the readings of the {level}s {both} are exchanged"
    elif steps == {1} or steps == {count - 1}:
        way = "next" if steps == {1} else "previous"
        sentence = f"the readings of each {level} stand under the {way} {level}"
    runs = several_runs([parts[k] for k in moved])
    scope = runs if level == "run" else parts[moved[0]]
    return _reordering(scope, sentence, order)


def _every(data: Suspect) -> Index:
    return np.arange(1 + int(data.session.reading_of_value[-1]), dtype=np.intp)


def _reordered(scope: Scope, turn: Turn) -> Index:
    """Readings to take, by number, with those that follow each other turned."""
    order = _every(scope.data)
    for part in scope.sequences:
        order[part.readings] = turn(part.readings)
    return order


def _reordering(
    scope: Scope, sentence: str, order: Index, lost: Index | None = None
) -> MistakeTrial | None:
    """The session with readings in another order; None where channels would meet."""
    data, session = scope.data, scope.session
    taken = members(session, order)
    same = np.array_equal(data.channel[taken], data.channel)
    if not same or not data.shown.all():
        return None
    y: Array = session.y[taken]
    dropped = [] if lost is None else [int(k) for k in lost]
    missing = np.isin(session.reading_of_value, dropped)
    if not ((y != session.y) & ~missing).any():
        return None
    lacks = missing if dropped else None
    return value_trial(scope, "order", sentence, y, missing=lacks)
