"""Readings that hold a part of others of their run: read before they settled, as
differences from the one before, as sums, as means.

Readings y of a run are linear in those without the mistake, y = Q m: the density of m is
|det Q| times that of y.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from oed.base import Array, Index
from oed.checks.findings import rounded
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, mistakes_of_scopes, value_trial
from oed.checks.session import SessionReadings

SHARE_STEP = 1e-4  #: step of the share of the reading before, for differences
MAX_SHARE = 0.98  #: share of the reading before, at most


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
    "of the reading before as it was shown": lambda n, a: np.asarray(
        np.linalg.solve(_chain(n, 1.0, -a), _chain(n, 1.0 - a))
    ),
    "of the reading before": lambda n, a: _chain(n, 1.0 - a, a),
}


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Readings of each run, of one and of the whole file that hold parts of others."""
    for text in FIXED:
        yield from mistakes_of_scopes(data.sequential, partial(_fixed, text))
    for text in LAGS:
        yield from mistakes_of_scopes(data.sequential, partial(_lagging, text))


def _groups(scope: Scope) -> list[Index]:
    """Values of each channel in the order in which they were read."""
    channel = scope.data.channel
    groups = []
    for part in scope.sequences:
        inside = part.shown
        groups += [
            np.flatnonzero(inside & (channel == c)) for c in set(channel[inside])
        ]
    return groups if all(3 <= len(group) <= 400 for group in groups) else []


def _drop_carried(
    scope: Scope, groups: list[Index], matrix: Callable[[int], Array]
) -> Array:
    """Values (N,) without what they hold of others."""
    y = scope.session.y.copy()
    for group in groups:
        y[group] = np.linalg.solve(matrix(len(group)), y[group])
    return y


def _fixed(text: str, scope: Scope) -> MistakeTrial | None:
    groups = _groups(scope)
    matrices = [FIXED[text](len(group)) for group in groups]
    if not groups or any(np.linalg.cond(q) > 1e4 for q in matrices):
        return None
    y = _drop_carried(scope, groups, FIXED[text])
    log_scale = -float(sum(np.linalg.slogdet(q)[1] for q in matrices))
    sentence = f"the readings{scope.of} are {text}"
    return value_trial(scope, "carried", sentence, y, log_scale=log_scale)


def _lagging(shown_part: str, scope: Scope) -> MistakeTrial | None:
    session = scope.session
    groups = _groups(scope)
    if not groups:
        return None
    count = sum(len(group) - 1 for group in groups)

    def without(share: float) -> Array:
        return _drop_carried(scope, groups, lambda n: LAGS[shown_part](n, share))

    def undo(amounts: Array) -> list[SessionReadings]:
        if not 0.0 <= amounts[0] <= MAX_SHARE:
            raise ValueError("a reading holds a part of the one before")
        return [session.with_y(without(float(amounts[0])))]

    def text(amounts: Array, sd: Array) -> str:
        share, error = (100.0 * float(v[0]) for v in (amounts, sd))
        return (
            f"the readings{scope.of} hold {rounded(share, error)} % (sd {error:.2g} %)"
            f" {shown_part}: read before they had settled, or through a filter"
        )

    def scaling(amounts: Array) -> float:
        return -count * float(np.log1p(-np.clip(amounts[0], -MAX_SHARE, MAX_SHARE)))

    return MistakeTrial(
        kind="carried",
        scope=scope,
        text=text,
        change=undo,
        amounts=np.zeros(1),
        steps=np.array([SHARE_STEP]),
        scaling=scaling,
        family=f"lag {shown_part} {scope.name}",
        columns=((session.y - without(SHARE_STEP)) / SHARE_STEP)[:, None],
    )
