"""Deviations from a nominal reading in place of readings, and the reverse."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed import units
from oed.arrays import Array
from oed.checks.mistakes.variant import Alternatives, Variant
from oed.checks.session import SessionReadings

#: units in which deviations are written
SCALES = {"m": (("", 1.0), (" in um", units.UM / units.MM)), "rad": (("", 1.0),)}


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """Readings plus and minus the instrument's length, or what the machine predicts.

    The readings of a machine's own constraints are 0 by definition, and no deviations.
    """
    measurement = session.measurement
    shown = session.shown
    if not shown.any():
        return
    predicted = measurement.readings(session.series, measurement.nominal)
    predicted = np.where(shown, predicted, 0.0)
    length = lengths(session)
    if np.isfinite(length).any():
        base = np.where(np.isfinite(length), length, 0.0)
        yield from _about(session, base, "the nominal length")
    yield from _about(session, predicted, "the readings of the nominal machine")


def _about(session: SessionReadings, base: Array, name: str) -> Iterator[Variant]:
    si = session.unit(str(session.values["channel"].iloc[0]))
    for words, factor in SCALES.get(si, (("", 1.0),)):
        for sign, reversed_sign in ((1.0, ""), (-1.0, " with the sign reversed")):
            what = f"the readings are deviations from {name}{words}{reversed_sign}"
            y = base + sign * factor * session.y
            scale = len(y) * float(np.log(factor))
            yield Variant("deviation", what, session.with_y(y), scale)
    what = f"the readings have {name} added twice: they are no deviations any more"
    yield Variant("deviation", what, session.with_y(session.y - base))


def lengths(session: SessionReadings) -> Array:
    """Reading (N,) that each instrument keeps by design; NaN where there is none."""
    values = np.full(len(session), np.nan)
    for name, setup in session.measurement.setups.items():
        if setup.instrument.fixed_reading is not None:
            first = setup.instrument.channels[0].name
            kept_reading = setup.instrument.fixed_reading(setup.settings)
            values[session.mask(name, first)] = kept_reading
    return values
