"""Readings that were sorted, or stand in an unknown order.

Where other readings predict those of a scope, each value is put where it is expected.
The density of sorted values is that of n! orders. Where nothing predicts them, sorted
values say nothing but their distribution.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy import optimize, special

from oed.base.arrays import Array, Index
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, members, plain

#: readings that are sorted at least, and at most where their order is unknown
LEAST, MOST = 5, 400
#: turns of prediction and order
TURNS = 6


@dataclasses.dataclass(frozen=True)
class _SortedOrder:
    """An order in which values stand, and the log number of orders it is one of."""

    words: str
    log_count: float


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The file, each set-up, each run and all runs, by rows and by columns."""
    runs = [run.readings for run in given.runs]
    for scope in given.scopes:
        yield from _in_scope(given, scope, [scope.readings], f"the readings{scope.of}")
    if len(runs) > 1 and not _is_sorted(given):
        subject = "the readings of each run"
        yield from _in_scope(given, given.file, runs, subject)


def _is_sorted(given: Given) -> bool:
    """Whether the whole file is sorted: so are its runs then."""
    return _order(given.session.y, [np.arange(len(given.session))]).log_count == 0.0


def _in_scope(
    given: Given, scope: Scope, groups: list[Index], subject: str
) -> Iterator[MistakeTrial]:
    sizes = [len(g) for g in groups]
    if min(sizes) < LEAST or max(sizes) > MOST or not given.shown.all():
        return
    channels = list(dict.fromkeys(given.channel[scope.values(given.session)]))
    tables = [_table(given, group, channels) for group in groups]
    if any(table is None for table in tables):
        return
    whole = len(channels) == 1
    for channel in channels:
        places = [members(given.session, g) for g in groups]
        of_channel = [p[given.channel[p] == channel] for p in places]
        column = given.session.column(str(channel)).name
        whose = subject if whole else f"{subject} of {column}"
        yield from _ordered(given, scope, of_channel, whose, is_alone=whole)
    if not whole:
        yield from _rows(given, scope, [t for t in tables if t is not None], subject)


def _table(given: Given, group: Index, channels: list[str]) -> Index | None:
    """Values (n, c) of a group of readings; None where channels differ."""
    places = members(given.session, group)
    if len(places) != len(group) * len(channels):
        return None
    table = places.reshape(len(group), len(channels))
    same = (given.channel[table] == np.array(channels)).all()
    return table if same else None


def _ordered(
    given: Given, scope: Scope, groups: list[Index], subject: str, *, is_alone: bool
) -> Iterator[MistakeTrial]:
    """Values of groups (n,) put where the others predict them, by their rank.

    `is_alone` says whether they are all that their readings have.
    """
    order = _order(given.session.y, groups)
    y = given.session.y.copy()
    for _ in range(TURNS):
        predicted = _predicted(given, y, np.concatenate(groups))
        before = y.copy()
        for places in groups:
            y[places[np.argsort(predicted[places])]] = np.sort(given.session.y[places])
        if np.array_equal(y, before):
            break
    sentence = f"{subject} are {order.words}"
    if not np.array_equal(y, given.session.y):
        yield _trial(given, scope, sentence, y, order.log_count)
    if order.log_count == 0.0 and is_alone:
        yield _without_places(given, scope, groups, sentence)


def _order(y: Array, groups: list[Index]) -> _SortedOrder:
    """Whether all groups are sorted, and how."""
    for words, key in (
        ("sorted by size", y),
        ("sorted by size, the largest first", -y),
        ("sorted by size without their sign", np.abs(y)),
    ):
        steps = [np.diff(key[places]) for places in groups]
        if all((step >= 0.0).all() for step in steps) and any(s.any() for s in steps):
            return _SortedOrder(words, 0.0)
    count = float(sum(special.gammaln(1.0 + len(places)) for places in groups))
    return _SortedOrder("in another order than their poses", count)


def _predicted(given: Given, y: Array, places: Index) -> Array:
    """Values (N,) predicted by those that are not in `places`; by all where these are
    most.
    """
    used = np.ones(len(y), dtype=bool)
    used[places] = False
    if used.sum() < len(places):
        used[:] = True
    white = (y - given.predicted) / given.sigma
    slopes = given.slopes / given.sigma[:, None]
    part = slopes[used]
    precision = part.T @ part + np.eye(part.shape[1])
    z = np.linalg.solve(precision, part.T @ white[used])
    return given.predicted + given.slopes @ z


def _rows(
    given: Given, scope: Scope, tables: list[Index], subject: str
) -> Iterator[MistakeTrial]:
    """Whole rows put where their values are expected (an assignment)."""
    y = given.session.y.copy()
    changed = False
    for table in tables:
        spread = given.spread[table].max(axis=0)
        expected = given.predicted[table] / spread
        values = given.session.y[table] / spread
        cost = ((expected[:, None] - values[None]) ** 2).sum(axis=2)
        _, source = optimize.linear_sum_assignment(cost)
        y[table] = given.session.y[table[source]]
        changed = changed or bool((source != np.arange(len(source))).any())
    if not changed:
        return
    firsts = [table[:, k] for table in tables for k in range(table.shape[1])]
    by_column = [
        _order(given.session.y, firsts[k :: tables[0].shape[1]])
        for k in range(tables[0].shape[1])
    ]
    by = [one for one in by_column if one.log_count == 0.0]
    count = float(sum(special.gammaln(1.0 + len(table)) for table in tables))
    words = by[0].words if by else "in another order than their poses"
    sentence = f"the rows of {subject.removeprefix('the ')} are {words}"
    yield _trial(given, scope, sentence, y, 0.0 if by else count)


def _trial(
    given: Given, scope: Scope, sentence: str, y: Array, log_count: float
) -> MistakeTrial:
    session = given.session
    return MistakeTrial(
        kind="disorder" if log_count else "sorting",
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [session.with_y(y)],
        y=y,
        log_prior=-log_count,
    )


def _without_places(
    given: Given, scope: Scope, groups: list[Index], sentence: str
) -> MistakeTrial:
    """Sorted values of which nothing but the distribution is used: a normal one."""
    session = given.session
    places = np.concatenate(groups)
    missing = np.zeros(len(session), dtype=bool)
    missing[places] = True
    log_density = 0.0
    for group in groups:
        y = session.y[group]
        sd = max(float(np.std(y)), float(np.median(given.sigma[group])))
        log_density += float(special.gammaln(1.0 + len(group)))
        log_density -= len(group) * (np.log(sd) + 0.5 * np.log(2.0 * np.pi) + 0.5)
    dropped = sorted({int(k) for k in session.reading_of_value[places]})
    is_all = len(dropped) == 1 + int(session.reading_of_value[-1])
    return MistakeTrial(
        kind="sorting",
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [] if is_all else [session.without(dropped)],
        missing=missing,
        log_missing=log_density,
    )
