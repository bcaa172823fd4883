"""Readings that hold a part of others of their run: read before they settled, as
differences from the one before, as sums, as means.

Readings y of a run are linear in those without the mistake, y = Q m: the density of m is
|det Q| times that of y.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from scipy import linalg

from oed.base import Array, Index
from oed.checks.findings import rounded
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, in_scopes, value_trial
from oed.checks.session import SessionReadings

#: readings of a group up to which they may hold parts of others, and fewest
MOST, LEAST = 400, 3
#: condition number from which on a matrix has no inverse here
SINGULAR = 1e4
#: share of the reading before, for differences, and largest one
STEP, LARGEST = 1e-4, 0.98


def _chain(count: int, rest: float = 1.0, before: float = 0.0) -> Array:
    """Matrix (n, n): a part of each but the first, and one of the reading before it."""
    diagonal = np.append(1.0, np.full(count - 1, rest))
    return np.diag(diagonal) + before * np.eye(count, k=-1)


def _mean_of_three(count: int) -> Array:
    near = np.eye(count) + np.eye(count, k=1) + np.eye(count, k=-1)
    return np.asarray(near / near.sum(axis=1, keepdims=True))


#: Q of a number of readings, in words
FIXED: dict[str, Callable[[int], Array]] = {
    "differences from the reading before": lambda n: _chain(n, 1.0, -1.0),
    "running sums": lambda n: np.tri(n),
    "means of each with its two neighbours": _mean_of_three,
}
#: Q of a number of readings n and a share a that the display holds of the reading before,
#: as it was shown or as it should be
LAGS: dict[str, Callable[[int, float], Array]] = {
    "of the reading before as it was shown": lambda n, a: linalg.solve(
        _chain(n, 1.0, -a), _chain(n, 1.0 - a)
    ),
    "of the reading before": lambda n, a: _chain(n, 1.0 - a, a),
}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings of each run, of one and of the whole file that hold parts of others."""
    for each in (True, False):
        scopes = [given.file] if each and len(given.runs) > 1 else given.scopes
        for words in FIXED:
            yield from in_scopes(scopes, partial(_fixed, given, words, each))
        for words in LAGS:
            yield from in_scopes(scopes, partial(_lagging, given, words, each))


def _groups(given: Given, scope: Scope, *, each: bool) -> list[Index]:
    """Values of each channel in the order in which they were read, by run or all."""
    session = given.session
    parts = given.runs_in(scope) if each or scope.level == "runs" else [scope]
    groups = []
    for part in parts:
        at = part.values(session) & given.shown
        groups += [
            np.flatnonzero(at & (given.channel == c)) for c in set(given.channel[at])
        ]
    return groups if all(LEAST <= len(group) <= MOST for group in groups) else []


def _where(given: Given, scope: Scope, *, each: bool) -> str:
    if scope.name:
        return scope.of
    return " of each run" if each and len(given.runs) > 1 else ""


def _without(
    given: Given, groups: list[Index], matrix: Callable[[int], Array]
) -> Array:
    """Values (N,) without what they hold of others."""
    y = given.session.y.copy()
    for group in groups:
        y[group] = np.linalg.solve(matrix(len(group)), y[group])
    return y


def _fixed(given: Given, words: str, each: bool, scope: Scope) -> MistakeTrial | None:
    groups = _groups(given, scope, each=each)
    matrices = [FIXED[words](len(group)) for group in groups]
    if not groups or any(np.linalg.cond(q) > SINGULAR for q in matrices):
        return None
    y = _without(given, groups, FIXED[words])
    log_scale = -float(sum(np.linalg.slogdet(q)[1] for q in matrices))
    sentence = f"the readings{_where(given, scope, each=each)} are {words}"
    return value_trial(
        given.session, "carried", scope, sentence, y, log_scale=log_scale
    )


def _lagging(given: Given, held: str, each: bool, scope: Scope) -> MistakeTrial | None:
    session, where = given.session, _where(given, scope, each=each)
    groups = _groups(given, scope, each=each)
    if not groups:
        return None
    count = sum(len(group) - 1 for group in groups)

    def without(share: float) -> Array:
        return _without(given, groups, lambda n: LAGS[held](n, share))

    def undo(amounts: Array) -> list[SessionReadings]:
        if not 0.0 <= amounts[0] <= LARGEST:
            raise ValueError("a reading holds a part of the one before")
        return [session.with_y(without(float(amounts[0])))]

    def words(amounts: Array, sd: Array) -> str:
        share, error = (100.0 * float(v[0]) for v in (amounts, sd))
        return (
            f"the readings{where} hold {rounded(share, error)} % (sd {error:.2g} %)"
            f" {held}: read before they had settled, or through a filter"
        )

    def scaling(amounts: Array) -> float:
        return -count * float(np.log1p(-np.clip(amounts[0], -LARGEST, LARGEST)))

    return MistakeTrial(
        kind="carried",
        scope=scope,
        words=words,
        session=session,
        change=undo,
        amounts=np.zeros(1),
        steps=np.array([STEP]),
        scaling=scaling,
        family=f"lag {held} {each} {scope.name}",
        columns=((session.y - without(STEP)) / STEP)[:, None],
    )
