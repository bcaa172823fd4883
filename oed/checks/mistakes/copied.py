"""Readings of one run, or one set-up, that are those of another to the last digit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from oed.base.arrays import Index
from oed.checks.copies import resolution
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, members, plain

#: step of readings with more digits than are looked at, in their noise
FINEST = 1e-6
#: fewest readings of which copies are looked for
LEAST = 3


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each run and set-up whose readings equal those of another one."""
    for level in ("run", "set-up"):
        scopes = [s for s in given.scopes if s.level == level]
        for one, other in itertools.permutations(scopes, 2):
            if _equal(given, one.readings, other.readings):
                yield _copied(given, one, other)


def _equal(given: Given, one: Index, other: Index) -> bool:
    if len(one) != len(other) or len(one) < LEAST:
        return False
    y, session = given.session.y, given.session
    first, second = (members(session, r) for r in (one, other))
    if len(first) != len(second):
        return False
    recorded = given.shown[first].all()
    return bool(recorded and np.array_equal(y[first], y[second]) and np.ptp(y[first]))


def _copied(given: Given, one: Scope, other: Scope) -> MistakeTrial:
    """The session without readings that are given already as those of another scope.

    They are certain then: their density is that of a value known to its last digit.
    """
    session = given.session
    missing = one.values(session)
    step = resolution(session, np.flatnonzero(missing))
    size = np.maximum(step, FINEST * given.sigma[missing])
    dropped = [int(k) for k in one.readings]
    sentence = f"the readings{one.of} are those{other.of}, copied"
    return MistakeTrial(
        kind="copied",
        scope=one,
        words=plain(sentence),
        undo=lambda amounts: [session.without(dropped)],
        missing=missing,
        log_missing=-float(np.log(size).sum()),
    )
