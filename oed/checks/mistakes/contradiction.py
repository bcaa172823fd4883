"""Readings of a run or a set-up that contradict all others, for a reason unknown."""

from __future__ import annotations

from collections.abc import Iterator

from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, plain


def trials(given: Given) -> Iterator[MistakeTrial]:
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
