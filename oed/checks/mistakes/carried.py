"""Readings that hold a part of others of their run: read before they settled, as
differences from the one before, as sums, as means.

Readings y of a run are K m, m those without the mistake; K is a matrix that a lag of
amount a makes, or a fixed one. Undone they are K^-1 y, with the density of |det K|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from oed.base.arrays import Array, Index
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, in_scopes, value_trial
from oed.checks.session import SessionReadings
from oed.checks.words import rounded

#: readings of a group up to which they may hold parts of others, and fewest
MOST, LEAST = 400, 3
#: condition number from which on a matrix has no inverse here
SINGULAR = 1e4
#: share of the reading before, for differences, and largest one
STEP, LARGEST = 1e-4, 0.98


def _before(count: int) -> Array:
    """Matrix (n, n) that takes the reading before each but the first."""
    return np.asarray(np.eye(count, k=-1))


def _mean_of_three(count: int) -> Array:
    near = np.eye(count) + np.eye(count, k=1) + np.eye(count, k=-1)
    return np.asarray(near / near.sum(axis=1, keepdims=True))


#: readings of those without the mistake (n, n), in words
FIXED: dict[str, Callable[[int], Array]] = {
    "differences from the reading before": lambda n: np.eye(n) - _before(n),
    "running sums": lambda n: np.tril(np.ones((n, n))),
    "means of each with its two neighbours": _mean_of_three,
}
#: whether the display holds a share of the reading before as shown, or as it should be
LAGS = {True: "of the reading before as it was shown", False: "of the reading before"}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings of each run, of one and of the whole file that hold parts of others."""
    for each in (True, False):
        scopes = [given.file] if each and len(given.runs) > 1 else given.scopes
        for words, matrix in FIXED.items():
            yield from in_scopes(scopes, partial(_fixed, given, words, matrix, each))
        for as_shown in LAGS:
            yield from in_scopes(scopes, partial(_lagging, given, as_shown, each))


def _groups(given: Given, scope: Scope, *, each: bool) -> list[Index]:
    """Values of each channel in the order in which they were read, by run or all."""
    session = given.session
    parts = [scope]
    if each or scope.level == "runs":
        parts = [s for s in given.runs if np.isin(s.readings, scope.readings).all()]
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


def _fixed(
    given: Given, words: str, matrix: Callable[[int], Array], each: bool, scope: Scope
) -> MistakeTrial | None:
    y, log_scale = given.session.y.copy(), 0.0
    groups = _groups(given, scope, each=each)
    for group in groups:
        k = matrix(len(group))
        sign, log_size = np.linalg.slogdet(k)
        if sign == 0.0 or np.linalg.cond(k) > SINGULAR:
            return None
        y[group] = np.linalg.solve(k, given.session.y[group])
        log_scale -= float(log_size)
    if not groups:
        return None
    sentence = f"the readings{_where(given, scope, each=each)} are {words}"
    return value_trial(given.session, "carried", scope, sentence, y, log_scale)


def _lagging(
    given: Given, as_shown: bool, each: bool, scope: Scope
) -> MistakeTrial | None:
    session = given.session
    groups = _groups(given, scope, each=each)
    if not groups:
        return None
    count = sum(len(group) - 1 for group in groups)

    def settled(share: float) -> Array:
        y = session.y.copy()
        for group in groups:
            shown = session.y[group]
            if as_shown:
                y[group[1:]] = (shown[1:] - share * shown[:-1]) / (1.0 - share)
                continue
            k = (1.0 - share) * np.eye(len(group)) + share * _before(len(group))
            k[0, 0] = 1.0
            y[group] = np.linalg.solve(k, shown)
        return y

    def undo(amounts: Array) -> list[SessionReadings]:
        if abs(amounts[0]) > LARGEST:
            raise ValueError("a reading holds less than all of the one before")
        return [session.with_y(settled(float(amounts[0])))]

    def words(amounts: Array, sd: Array) -> str:
        share, error = (100.0 * float(v[0]) for v in (amounts, sd))
        return (
            f"the readings{_where(given, scope, each=each)} hold"
            f" {rounded(share, error)} % (sd {error:.2g} %) {LAGS[as_shown]}: read before"
            " they had settled, or through a filter"
        )

    def scaling(amounts: Array) -> float:
        return -count * float(np.log(max(abs(1.0 - amounts[0]), 1e-12)))

    slope = (session.y - settled(STEP)) / STEP
    return MistakeTrial(
        kind="carried",
        scope=scope,
        words=words,
        undo=undo,
        amounts=np.zeros(1),
        steps=np.array([STEP]),
        scaling=scaling,
        linear_scaling=lambda amounts: scaling(np.clip(amounts, -LARGEST, LARGEST)),
        family=f"lag {as_shown} {each} {scope.name}",
        columns=slope[:, None],
    )
