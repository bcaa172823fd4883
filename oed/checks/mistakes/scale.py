"""Readings, or their deviations from what is nominal, times a simple factor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base.arrays import Mask
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, value_trial

#: what readings are of what they should be
FACTORS = {
    "half of": 0.5,
    "twice": 2.0,
    "a tenth of": 0.1,
    "ten times": 10.0,
    "a hundredth of": 0.01,
    "a hundred times": 100.0,
}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The readings and each column, times each factor."""
    for scope, values in given.shown_scopes():
        yield from _scaled(given, scope, f"readings{scope.of}", values)
    for scope, channel, values in given.channel_scopes():
        if len(dict.fromkeys(given.channel[scope.values(given.session)])) > 1:
            column = given.session.column(channel).name
            subject = f"readings of {column}{scope.within}"
            yield from _scaled(given, scope, subject, values)
    for scope, values in given.instruments:
        yield from _scaled(given, scope, f"readings{scope.of}", values)


def _scaled(
    given: Given, scope: Scope, subject: str, values: Mask
) -> Iterator[MistakeTrial]:
    session, y = given.session, given.session.y
    bases = {f"the {subject}": 0.0 * y}
    for origin, base in given.bases(values).items():
        bases[f"the deviations of the {subject} from {origin}"] = base
    for what, base in bases.items():
        about = values & np.isfinite(base)
        for words, factor in FACTORS.items():
            changed = np.where(about, base + (y - base) / factor, y)
            mistaken = np.where(about, base + (y - base) * factor, y)
            sentence = f"{what} are {words} what they should be"
            log_scale = -float(about.sum() * np.log(factor))
            yield value_trial(
                session, "scale", scope, sentence, changed, log_scale, mistaken
            )
