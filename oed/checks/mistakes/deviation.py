"""Deviations from a nominal reading in place of readings, and the reverse."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Mask
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, value_trial

#: fine units in which deviations are written, by SI unit
FINE = {"m": ("um", units.UM), "rad": ("arcsec", units.ARCSEC)}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings plus and minus the instrument's length, or what the machine predicts."""
    for scope, values in given.shown_scopes():
        for origin, base in given.bases(values).items():
            about = values & np.isfinite(base)
            yield from _about(given, scope, about, base, origin)


def _about(
    given: Given, scope: Scope, values: Mask, base: Array, origin: str
) -> Iterator[MistakeTrial]:
    session = given.session
    origin = origin.replace(
        "the nominal machine", "the readings of the nominal machine"
    )
    for words, factor in _scales(given, values).items():
        for sign, reversed_sign in ((1.0, ""), (-1.0, " with the sign reversed")):
            y = np.where(values, base + sign * factor * session.y, session.y)
            sentence = (
                f"the readings{scope.of} are deviations from {origin}{words}"
                f"{reversed_sign}"
            )
            log_scale = float(np.log(factor[values]).sum())
            yield value_trial(session, "deviation", scope, sentence, y, log_scale)
    y = np.where(values, session.y - base, session.y)
    sentence = (
        f"the readings{scope.of} have {origin} added twice: they are no deviations any"
        " more"
    )
    yield value_trial(session, "deviation", scope, sentence, y)


def _scales(given: Given, values: Mask) -> dict[str, Array]:
    """Factors (N,) on the values as read: 1, and those of fine units, in words."""
    ones = np.ones(len(values))
    fine, names = ones.copy(), []
    for channel in dict.fromkeys(given.channel[values]):
        column = given.session.column(str(channel))
        name, factor = FINE.get(column.unit, ("", column.factor))
        if factor != column.factor:
            fine[given.channel == channel] = factor / column.factor
            names.append(name)
    scales = {"": ones}
    if names:
        scales[f" in {' and '.join(dict.fromkeys(names))}"] = fine
    return scales
