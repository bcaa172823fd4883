"""Parts of a session that contradict others for a reason unknown, are copied from others,
or fit alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from oed.base import Index
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import (
    MistakeTrial,
    log_density_of_known,
    members,
    value_trial,
)

#: readings that a part has at least, and of which copies are looked for
LEAST, LEAST_COPIED = 6, 3
#: readings of a session up to which it is divided at every one
MOST_CUT = 300


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The session in two parts, and without each run and set-up: it may be anything, or
    equal another one to the last digit.
    """
    yield from _divisions(given)
    for level in ("run", "set-up"):
        scopes = [s for s in given.scopes if s.level == level]
        for one, other in itertools.permutations(scopes, 2):
            if _equal(given, one.readings, other.readings):
                yield _copied(given, one, other)
    for scope in given.scopes:
        if scope.level in ("run", "set-up"):
            sentence = (
                f"the readings{scope.of} contradict all others, and no usual mistake"
                " explains how"
            )
            missing = scope.values(given.session)
            yield value_trial(
                given.session, "contradiction", scope, sentence, missing=missing
            )


# -- copies ----------------------------------------------------------------------------


def _equal(given: Given, one: Index, other: Index) -> bool:
    if len(one) != len(other) or len(one) < LEAST_COPIED:
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
    missing = one.values(given.session)
    log_missing = log_density_of_known(given, missing, missing)
    sentence = f"the readings{one.of} are those{other.of}, copied"
    return value_trial(
        given.session,
        "copied",
        one,
        sentence,
        missing=missing,
        log_missing=log_missing,
    )


# -- two parts that fit alone ----------------------------------------------------------


def _divisions(given: Given) -> Iterator[MistakeTrial]:
    """The session divided at every reading, or at the ends of runs where it is long."""
    count = 1 + int(given.session.reading_of_value[-1])
    places = list(range(LEAST, count - LEAST + 1))
    if count > MOST_CUT:
        ends = [int(run.readings[0]) for run in given.runs]
        places = [k for k in ends if LEAST <= k <= count - LEAST]
    for place in places:
        yield _divided(given, place, count)


def _divided(given: Given, place: int, count: int) -> MistakeTrial:
    session, every = given.session, np.arange(count, dtype=np.intp)
    last, first = session.rows(every[place - 1 : place + 1])
    before, after = (_of_run(given, part) for part in (every[:place], every[place:]))
    sentence = (
        f"the readings up to row {last}{before} and those from row {first}{after} fit"
        " alone but not together: another machine, or something moved between them"
    )
    parts = session.reading_of_value >= place
    return value_trial(
        session, "change", given.file, sentence, family="change", parts=parts
    )


def _of_run(given: Given, readings: Index) -> str:
    """The run whose readings these are, in brackets; empty where they are of several."""
    for run in given.runs:
        if np.array_equal(run.readings, readings):
            return f" ({run.name})"
    return ""
