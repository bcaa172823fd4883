"""Commanded poses with a wrong sign, exchanged columns, a turned start or another unit."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from oed import units
from oed.arrays import Array
from oed.checks.mistakes.variant import Alternatives, Variant, recommanded
from oed.checks.session import SessionReadings
from oed.dataset.columns import column_name
from oed.machine import Coordinate

#: angles by which a circle may start elsewhere, deg
TURNS = (90.0, -90.0, 180.0)


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """All set-ups' commands with each change undone, those that can be reached."""
    for what, change in _changes(session.measurement.machine.command):
        changed: SessionReadings | None = session
        for setup in dict.fromkeys(s.setup for s in session.series):
            changed = None if changed is None else recommanded(changed, setup, change)
        if changed is not None and not _same(session, changed):
            yield Variant("pose", what, changed)


def _same(session: SessionReadings, changed: SessionReadings) -> bool:
    """Whether all poses are as given, turns of 360 deg aside."""
    pairs = zip(session.series, changed.series, strict=True)
    return all(np.allclose(a.q, b.q, rtol=0.0, atol=1e-12) for a, b in pairs)


def _changes(
    command: tuple[Coordinate, ...],
) -> Iterator[tuple[str, Callable[[Array], Array]]]:
    names = [column_name(c.name, c.unit) for c in command]
    for k, coordinate in enumerate(command):
        if coordinate.lower < 0.0 < coordinate.upper or coordinate.unit == "rad":
            yield f"the sign of {names[k]} is reversed", _scaled(k, -1.0)
        if coordinate.unit == "rad":
            for turn in TURNS:
                what = f"{names[k]} starts {turn:.0f} deg from where it should"
                yield what, _moved(k, -turn * units.DEG)
            what = f"{names[k]} is in rad, not in deg"
            yield what, _scaled(k, 1.0 / units.DEG)
    for j, k in itertools.combinations(range(len(command)), 2):
        if command[j].unit == command[k].unit:
            what = f"the columns {names[j]} and {names[k]} are exchanged"
            yield what, _exchanged(j, k)


def _scaled(k: int, factor: float) -> Callable[[Array], Array]:
    def change(command: Array) -> Array:
        scale = np.ones(command.shape[1])
        scale[k] = factor
        return np.asarray(command * scale)

    return change


def _moved(k: int, amount: float) -> Callable[[Array], Array]:
    def change(command: Array) -> Array:
        shift = np.zeros(command.shape[1])
        shift[k] = amount
        return np.asarray(command + shift)

    return change


def _exchanged(j: int, k: int) -> Callable[[Array], Array]:
    def change(command: Array) -> Array:
        changed = command.copy()
        changed[:, [j, k]] = command[:, [k, j]]
        return changed

    return change
