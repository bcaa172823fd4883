"""Parts of a session that contradict others for a reason unknown, are copied from others,
or fit alone.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from oed.base import Index
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    log_density_of_known,
    members,
    value_trial,
)

MIN_PART = 6  #: readings of a part, at least
MAX_CUT = 300  #: readings of a session up to which it is divided at every one


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """The session in two parts, and without each run and set-up: it may be anything, or
    equal another one to the last digit.
    """
    yield from _divisions(data)
    for level in ("run", "set-up"):
        scopes = [s for s in data.scopes if s.level == level]
        for one, other in itertools.permutations(scopes, 2):
            if _equal(data, one.readings, other.readings):
                yield _copied(one, other)
    for scope in data.scopes:
        if scope.level in ("run", "set-up"):
            sentence = (
                f"the readings{scope.of} contradict all others, and no usual mistake"
                " explains how"
            )
            yield value_trial(scope, "contradiction", sentence, missing=scope.values)


# -- copies ----------------------------------------------------------------------------
def _equal(data: Suspect, one: Index, other: Index) -> bool:
    if len(one) != len(other) or len(one) < 3:
        return False
    y, session = data.session.y, data.session
    first, second = (members(session, r) for r in (one, other))
    if len(first) != len(second):
        return False
    recorded = data.shown[first].all()
    return bool(recorded and np.array_equal(y[first], y[second]) and np.ptp(y[first]))


def _copied(one: Scope, other: Scope) -> MistakeTrial:
    """The session without readings of a scope that are given already by another."""
    missing = one.values
    log_missing = log_density_of_known(one.data, missing, missing)
    sentence = f"the readings{one.of} are those{other.of}, copied"
    return value_trial(
        one, "copied", sentence, missing=missing, log_missing=log_missing
    )


# -- two parts that fit alone ----------------------------------------------------------
def _divisions(data: Suspect) -> Iterator[MistakeTrial]:
    """The session divided at every reading, or at the ends of runs where it is long."""
    count = 1 + int(data.session.reading_of_value[-1])
    places = list(range(MIN_PART, count - MIN_PART + 1))
    if count > MAX_CUT:
        ends = [int(run.readings[0]) for run in data.runs]
        places = [k for k in ends if MIN_PART <= k <= count - MIN_PART]
    for cut in places:
        yield _divided(data, cut, count)


def _divided(data: Suspect, cut: int, count: int) -> MistakeTrial:
    session = data.session
    every = np.arange(count, dtype=np.intp)
    last, first = session.rows(every[cut - 1 : cut + 1])
    before, after = (
        _run_in_brackets(data, part) for part in (every[:cut], every[cut:])
    )
    sentence = (
        f"the readings up to row {last}{before} and those from row {first}{after} fit"
        " alone but not together: another machine, or something moved between them"
    )
    parts = session.reading_of_value >= cut
    return value_trial(data.file, "change", sentence, family="change", parts=parts)


def _run_in_brackets(data: Suspect, readings: Index) -> str:
    """The run whose readings these are, in brackets; empty where they are of several."""
    for run in data.runs:
        if np.array_equal(run.readings, readings):
            return f" ({run.name})"
    return ""
