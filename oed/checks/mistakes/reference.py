"""Readings that are differences from another pose of their run than its first."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from oed.base.arrays import Index
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import Moved, by_run, moved_trials
from oed.checks.mistakes.trial import MistakeTrial
from oed.measurement.measurement import Series

#: readings of a run whose pose may be the reference, of so many
PLACES: dict[str, Callable[[int], int]] = {
    "last": lambda count: count - 1,
    "middle": lambda count: (count - 1) // 2,
    "second": lambda count: 0,
}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The last, middle and second pose of each run as its reference."""
    session = given.session
    setups = session.measurement.setups
    if all(setups[s.setup].instrument.reference != "run" for s in session.series):
        return
    for name, place in PLACES.items():
        moved = _differences_from(given, place)
        sentence = (
            f"the readings{{of}} are differences from the {name} pose of each run"
        )
        yield from moved_trials(given, "reference", sentence, moved)


def _differences_from(given: Given, place: Callable[[int], int]) -> Moved:
    setups = given.session.measurement.setups

    def moved(series: Series) -> Series | None:
        if setups[series.setup].instrument.reference != "run":
            return series
        index: Index = series.index.copy()
        for rows in by_run(series):
            index[rows, 1] = series.index[rows[place(len(rows))], 0]
        if np.array_equal(index, series.index):
            return None
        return dataclasses.replace(series, index=index)

    return moved
