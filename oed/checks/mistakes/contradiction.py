"""Parts of a session that contradict others for a reason unknown, or fit alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base.arrays import Array, Index
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, plain
from oed.checks.session import SessionReadings

#: readings that a part has at least
LEAST = 6
#: readings of a session up to which it is divided at every one
MOST_CUT = 300


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The session in two parts, and without each run and set-up."""
    yield from _divisions(given)
    yield from _contradictions(given)


def _contradictions(given: Given) -> Iterator[MistakeTrial]:
    """Each run and set-up whose readings may be anything."""
    for scope in given.scopes:
        if scope.level in ("run", "set-up"):
            yield _unknown(given, scope)


def _unknown(given: Given, scope: Scope) -> MistakeTrial:
    session = given.session
    dropped = [int(k) for k in scope.readings]
    sentence = f"the readings{scope.of} contradict all others, and no usual mistake explains how"
    return MistakeTrial(
        kind="contradiction",
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [session.without(dropped)],
        missing=scope.values(session),
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

    def undo(amounts: Array) -> list[SessionReadings]:
        return [session.take(every[:place]), session.take(every[place:])]

    return MistakeTrial(
        kind="change",
        scope=given.file,
        words=plain(sentence),
        undo=undo,
        family="change",
        parts=session.reading_of_value >= place,
    )


def _of_run(given: Given, readings: Index) -> str:
    """The run whose readings these are, in brackets; empty where they are of several."""
    for run in given.runs:
        if np.array_equal(run.readings, readings):
            return f" ({run.name})"
    return ""
