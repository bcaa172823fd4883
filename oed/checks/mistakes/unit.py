"""Readings in another unit than their column states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base import units
from oed.base.arrays import Mask
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, value_trial

#: units that a file's readings may be in, beside those of a column
OTHERS = {"m": {"inch": units.INCH}, "rad": {}, "1": {}}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The readings of a kind, and of a column, in each other unit of that kind."""
    for scope, values in given.shown_scopes():
        kinds = list(dict.fromkeys(given.unit[values]))
        for si in kinds:
            of_kind = values & (given.unit == si)
            channels = list(dict.fromkeys(given.channel[of_kind]))
            whose = (
                scope.of
                if len(kinds) == 1
                else f" ({_names(given, channels)}){scope.of}"
            )
            yield from _in_units(given, scope, f"the readings{whose} are", of_kind)
            if len(channels) == 1:
                continue
            for channel in channels:
                subject = f"{_names(given, [channel])}{scope.within} is"
                of_channel = of_kind & (given.channel == channel)
                yield from _in_units(given, scope, subject, of_channel)
    yield from _of_instruments(given)


def _of_instruments(given: Given) -> Iterator[MistakeTrial]:
    for scope, values in given.instruments:
        yield from _in_units(given, scope, f"the readings{scope.of} are", values)


def _names(given: Given, channels: list[str]) -> str:
    return ", ".join(given.session.column(c).name for c in channels)


def _in_units(
    given: Given, scope: Scope, subject: str, values: Mask
) -> Iterator[MistakeTrial]:
    session = given.session
    stated = session.column(str(given.channel[values][0]))
    word = stated.name.rpartition("_")[2]
    for name, factor in _factors(stated.unit).items():
        if factor == stated.factor:
            continue
        ratio = factor / stated.factor
        y = np.where(values, session.y * ratio, session.y)
        log_scale = float(values.sum() * np.log(ratio))
        sentence = f"{subject} in {name}, not in {word}"
        yield value_trial(session, "unit", scope, sentence, y, log_scale)


def _factors(si: str) -> dict[str, float]:
    """Factors to SI of the units of a kind, by name."""
    known = {name: factor for name, (unit, factor) in units.UNITS.items() if unit == si}
    return {**known, **OTHERS.get(si, {})}
