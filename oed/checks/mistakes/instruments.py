"""Readings that one instrument may have taken in several set-ups of a session.

A gauge, a bar or a laser goes from set-up to set-up, and from channel to channel: what is
wrong with it is wrong wherever it was used, and nowhere else.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base.arrays import Mask
from oed.checks.mistakes.scope import Scope
from oed.checks.session import SessionReadings

#: sets of set-ups and channels that are tried, at most: all of a number of set-ups, or none
MOST_SETS = 60
#: a set-up, and channels of it
Use = tuple[str, tuple[str, ...]]


def shared_instruments(session: SessionReadings) -> list[tuple[Scope, Mask]]:
    """Each set of values (N,) that one instrument may have read, in two set-ups or more.

    Sets that are all readings of a unit or of a channel concern the file, and are left out.
    """
    known = {mask.tobytes() for mask in _of_file(session)}
    sets: list[tuple[Scope, Mask]] = []
    for uses_by_size in _uses(session):
        some = []
        for uses in uses_by_size:
            mask = _values(session, uses)
            if mask.tobytes() not in known:
                known.add(mask.tobytes())
                some.append((_scope(session, uses, mask), mask))
            if len(sets) + len(some) > MOST_SETS:
                return sets
        sets += some
    return sets


def _of_file(session: SessionReadings) -> Iterator[Mask]:
    channel = session.values["channel"].to_numpy()
    names = list(dict.fromkeys(channel))
    unit = np.asarray([session.unit(name) for name in channel])
    for name in names:
        yield np.asarray(channel == name) & session.shown
    for si in dict.fromkeys(unit):
        yield np.asarray(unit == si) & session.shown


def _uses(session: SessionReadings) -> Iterator[Iterator[tuple[Use, ...]]]:
    """Set-ups with channels of one unit, by the number of set-ups."""
    channels = _channels_by_unit(session)
    setups = list(dict.fromkeys(s.setup for s in session.series))
    for size in range(2, len(setups) + 1):
        yield _uses_of(channels, itertools.combinations(setups, size))


def _uses_of(
    channels: Sequence[dict[str, list[str]]], groups: Iterator[tuple[str, ...]]
) -> Iterator[tuple[Use, ...]]:
    for members in groups:
        for by_setup in channels:
            if all(name in by_setup for name in members):
                yield tuple((name, tuple(by_setup[name])) for name in members)
                choices = [[(name, (c,)) for c in by_setup[name]] for name in members]
                yield from itertools.product(*choices)


def _channels_by_unit(session: SessionReadings) -> list[dict[str, list[str]]]:
    """Channels with a display by set-up, for each unit in which columns are."""
    by_unit: dict[tuple[str, float], dict[str, list[str]]] = {}
    shown = session.values[session.shown]
    for setup, channel in dict.fromkeys(
        zip(shown["setup"], shown["channel"], strict=True)
    ):
        column = session.column(channel)
        of_unit = by_unit.setdefault((column.unit, column.factor), {})
        of_unit.setdefault(setup, []).append(channel)
    return list(by_unit.values())


def _values(session: SessionReadings, uses: Sequence[Use]) -> Mask:
    mask = np.zeros(len(session), dtype=bool)
    for setup, channels in uses:
        for channel in channels:
            mask |= session.mask(setup, channel)
    return mask


def _scope(session: SessionReadings, uses: Sequence[Use], mask: Mask) -> Scope:
    places = []
    for setup, channels in uses:
        columns = ", ".join(session.column(c).name for c in channels)
        places.append(f"{columns} of {setup}")
    readings = np.unique(session.reading_of_value[mask])
    return Scope("instrument", f"one instrument ({'; '.join(places)})", readings)
