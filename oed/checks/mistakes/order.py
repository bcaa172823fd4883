"""Readings in another order than their poses: reversed, or shifted by some rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from oed.arrays import Index
from oed.checks.mistakes.variant import Alternatives, Variant
from oed.checks.session import SessionReadings

#: rows by which readings are shifted
SHIFTS = (1, -1, 2, -2)
#: readings of a run from which on it is turned
LEAST = 4


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """Readings reversed and shifted, in each run, in one run, and in the whole file."""
    runs = run_members(session)
    y, reading = session.y, session.reading_of_value
    backward = _reordered(session, runs, lambda rows: rows[::-1])
    yield Variant("order", "the readings of each run are in reversed order", backward)
    file = [np.arange(1 + int(reading[-1]), dtype=np.intp)]
    if len(runs) > 1:
        reversed_file = _reordered(session, file, lambda rows: rows[::-1])
        what = "the readings of the file are in reversed order"
        yield Variant("order", what, reversed_file)
        for name, rows in zip(run_names(session), runs, strict=True):
            turned = _reordered(session, [rows], lambda r: r[::-1])
            what = f"the readings of run {name} are in reversed order"
            yield Variant("order", what, turned)
        if len(runs[0]) == len(runs[1]) and len(runs) == 2:
            swapped = _taken(session, np.concatenate([runs[1], runs[0]]))
            names = " and ".join(run_names(session))
            what = f"the readings of the runs {names} are exchanged"
            yield Variant("order", what, session.with_y(y[swapped]))
    setups = [np.unique(reading[session.mask(s.setup)]) for s in session.series]
    if 1 < len(setups) < len(runs):
        for series, rows in zip(session.series, setups, strict=True):
            turned = _reordered(session, [rows], lambda r: r[::-1])
            what = f"the readings of set-up {series.setup} are in reversed order"
            yield Variant("order", what, turned)
    if len(setups) == 2 and len(setups[0]) == len(setups[1]):
        order = _taken(session, np.concatenate(setups[::-1]))
        if _same_channels(session, order):
            names = " and ".join(s.setup for s in session.series)
            what = f"the readings of the set-ups {names} are exchanged"
            yield Variant("order", what, session.with_y(y[order]))
    for shift in SHIFTS:
        count = f"{abs(shift)} row{'s' if abs(shift) > 1 else ''}"
        way = "late" if shift > 0 else "early"
        yield from _shifted(session, runs, shift, f"in each run {count} too {way}")
        if len(runs) > 1:
            words = f"in the file {count} too {way}"
            yield from _shifted(session, file, shift, words)


def run_members(session: SessionReadings) -> list[Index]:
    """Readings, by number, of each run."""
    frame = session.values
    reading = session.reading_of_value
    groups = frame.groupby(["setup", "run"], sort=False).indices.values()
    return [np.unique(reading[rows]) for rows in groups]


def run_names(session: SessionReadings) -> list[str]:
    """Name of each run, in the order of `run_members`."""
    return [
        str(run)
        for _, run in session.values.groupby(["setup", "run"], sort=False).groups
    ]


def _taken(session: SessionReadings, order: Index) -> Index:
    """Values (N,) to take, for readings in another order; channels stay in place."""
    reading = session.reading_of_value
    counts = np.bincount(reading)
    starts = np.concatenate([[0], np.cumsum(counts)])
    return np.concatenate([np.arange(starts[k], starts[k + 1]) for k in order])


def _reordered(
    session: SessionReadings, groups: list[Index], turn: Callable[[Index], Index]
) -> SessionReadings:
    """The session with the readings of each group turned, poses in place."""
    order = np.arange(1 + int(session.reading_of_value[-1]), dtype=np.intp)
    for rows in groups:
        order[rows] = turn(rows)
    taken = _taken(session, order)
    if len(taken) != len(session) or not _same_channels(session, taken):
        return session
    return session.with_y(session.y[taken])


def _same_channels(session: SessionReadings, taken: Index) -> bool:
    channel = session.values["channel"].to_numpy()
    return bool((channel[taken] == channel).all())


def _shifted(
    session: SessionReadings, groups: list[Index], shift: int, words: str
) -> Iterator[Variant]:
    """Readings that stand `shift` rows too late, put back; first cyclic, then cut."""
    turned = _reordered(session, groups, lambda rows: np.roll(rows, -shift))
    lost = [rows[-shift:] if shift > 0 else rows[:-shift] for rows in groups]
    dropped = np.concatenate(lost)
    if len(dropped) >= len(session) - LEAST:
        return
    yield Variant("order", f"the readings stand {words}", turned.without(list(dropped)))
