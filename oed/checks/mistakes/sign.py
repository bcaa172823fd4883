"""Readings, or their deviations from what is nominal, with the sign reversed or lost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base.arrays import Mask
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, value_trial

#: standard deviations of a prediction from zero from which on its sign is known
SURE = 3.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each channel with the other sign, and with deviations of the other sign."""
    for scope, channel, values in given.channel_scopes():
        column = given.session.column(channel).name
        yield from _reversed(given, scope, f"{column}{scope.within}", values)
        yield from _lost(given, scope, f"{column}{scope.within}", values)
    for scope, values in given.shown_scopes():
        if len(dict.fromkeys(given.channel[values])) > 1:
            y = np.where(values, -given.session.y, given.session.y)
            sentence = f"the sign of all readings{scope.of} is reversed"
            yield value_trial(given.session, "sign", scope, sentence, y)
    for scope, values in given.instruments:
        yield from _reversed(given, scope, f"the readings{scope.of}", values)


def _reversed(
    given: Given, scope: Scope, of: str, values: Mask
) -> Iterator[MistakeTrial]:
    session, y = given.session, given.session.y
    bases = {f"the sign of {of} is reversed": 0.0 * y}
    for origin, base in given.bases(values).items():
        bases[f"the sign of the deviations of {of} from {origin} is reversed"] = base
    for sentence, base in bases.items():
        about = values & np.isfinite(base)
        changed = np.where(about, 2.0 * base - y, y)
        yield value_trial(session, "sign", scope, sentence, changed)


def _lost(given: Given, scope: Scope, of: str, values: Mask) -> Iterator[MistakeTrial]:
    """Readings that are all positive, or all negative, where some should not be.

    A reading has a sign to lose where its prediction is surely above or below zero.
    """
    y, sign = given.session.y, np.sign(given.predicted)
    if not (np.all(y[values] >= 0.0) or np.all(y[values] <= 0.0)):
        return
    is_known = np.abs(given.predicted) > SURE * given.spread
    changed = np.where(values & is_known, sign * np.abs(y), y)
    if (changed != y).any() and (changed != -y)[values].any():
        sentence = f"the sign of {of} is lost: all readings have one sign"
        yield value_trial(given.session, "sign", scope, sentence, changed)
