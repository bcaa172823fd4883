"""Columns of readings exchanged or turned: permutations of channels of one unit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, in_scopes, value_trial

#: channels of one unit that are permuted, at most
MOST_CHANNELS = 3


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Every permutation of the columns of one unit, with every choice of signs."""
    by_unit: dict[str, list[str]] = {}
    for channel in dict.fromkeys(given.channel[given.shown]):
        by_unit.setdefault(given.session.unit(channel), []).append(str(channel))
    for names in (few for some in by_unit.values() for few in _groups(some)):
        for order in itertools.permutations(names):
            for signs in itertools.product((1.0, -1.0), repeat=len(names)):
                if order == tuple(names) and sum(signs) > len(names) - 4.0:
                    continue  # the sign of one alone: see `values`
                on = partial(_exchanged, given, names, order, signs)
                yield from in_scopes(given.scopes, on)


def _groups(names: list[str]) -> list[list[str]]:
    """Channels that are permuted together: pairs alone where there are many."""
    if len(names) <= MOST_CHANNELS:
        return [names]
    return [list(pair) for pair in itertools.combinations(names, 2)]


def _exchanged(
    given: Given,
    names: list[str],
    order: tuple[str, ...],
    signs: tuple[float, ...],
    scope: Scope,
) -> MistakeTrial | None:
    """The session with each channel of `names` taken from that of `order`."""
    session = given.session
    values = scope.values(session) & given.shown
    y = session.y.copy()
    for target, source, sign in zip(names, order, signs, strict=True):
        to = values & (given.channel == target)
        taken = values & (given.channel == source)
        if to.sum() != taken.sum():
            return None
        y[to] = sign * session.y[taken]
    column = {name: session.column(name).name for name in names}
    moved = [(a, b) for a, b in zip(names, order, strict=True) if a != b]
    if min(signs) > 0.0:
        exchanged = [column[a] for a, _ in moved]
        words = f"{', '.join(exchanged[:-1])} and {exchanged[-1]}"
        sentence = f"the columns {words} are exchanged{scope.within}"
    else:
        triples = zip(names, order, signs, strict=True)
        axes = [
            f"{column[a]} is {'-' if s < 0 else ''}{column[b]}" for a, b, s in triples
        ]
        sentence = f"the axes stand otherwise{scope.within}: {', '.join(axes)}"
    if np.array_equal(y, session.y):
        return None
    return value_trial(session, "columns", scope, sentence, y)
