"""Columns of readings exchanged: each permutation of channels of one unit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from oed.checks.mistakes.variant import Alternatives, Variant
from oed.checks.session import SessionReadings

#: channels of one unit that are permuted, at most
MOST_CHANNELS = 4


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """Every permutation of the columns of one unit that is not the one given."""
    channels = list(dict.fromkeys(session.values["channel"]))
    by_unit: dict[str, list[str]] = {}
    for channel in channels:
        by_unit.setdefault(session.unit(channel), []).append(channel)
    for names in by_unit.values():
        if not 1 < len(names) <= MOST_CHANNELS:
            continue
        for permuted in itertools.permutations(names):
            changes = [(a, b) for a, b in zip(names, permuted, strict=True) if a != b]
            if changes:
                exchanged = _exchanged(session, changes)
                if exchanged is not None:
                    yield exchanged


def _exchanged(
    session: SessionReadings, changes: list[tuple[str, str]]
) -> Variant | None:
    """The session with each first channel taken from the column of the second."""
    y = session.y.copy()
    for setup in dict.fromkeys(session.values["setup"]):
        for target, source in changes:
            to, given = session.mask(setup, target), session.mask(setup, source)
            if to.sum() != given.sum():
                return None
            y[np.flatnonzero(to)] = session.y[given]
    columns = [session.column(name).name for name, _ in changes]
    words = f"{', '.join(columns[:-1])} and {columns[-1]}"
    return Variant("columns", f"the columns {words} are exchanged", session.with_y(y))
