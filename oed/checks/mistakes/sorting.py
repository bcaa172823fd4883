"""Readings that were sorted, or stand in an unknown order.

Where other readings predict those of a scope, each value is put where it is expected.
The density of sorted values is that of n! orders. Where nothing predicts them, sorted
values say nothing but their distribution.
"""

from collections.abc import Iterator

import numpy as np
import scipy  # its parts load when first used

from oed.base import Array, Index
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, members, value_trial

UNKNOWN_ORDER = "in another order than their poses"


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """The file, each set-up, each run and all runs, by rows and by columns."""
    every = [np.arange(len(data.session))]
    for scope in data.sequential:
        if not scope.each or _order(data, every) == UNKNOWN_ORDER:
            yield from _scope_trials(scope)


def _scope_trials(scope: Scope) -> Iterator[MistakeTrial]:
    data, groups = scope.data, [part.readings for part in scope.sequences]
    sizes = [len(g) for g in groups]
    if min(sizes) < 5 or max(sizes) > 400 or not data.shown.all():
        return
    subject = f"readings{scope.of}"
    channels = list(scope.channels)
    tables = [_table(data, group, channels) for group in groups]
    complete = [table for table in tables if table is not None]
    if len(complete) < len(tables):
        return
    if len(channels) == 1:
        yield from _ordered(scope, complete, f"the {subject}", is_alone=True)
        return
    for k, channel in enumerate(channels):
        whose = f"the {subject} of {data.session.column(channel).name}"
        yield from _ordered(scope, [t[:, k : k + 1] for t in complete], whose)
    yield from _ordered(scope, complete, f"the rows of {subject}")


def _table(data: Suspect, group: Index, channels: list[str]) -> Index | None:
    """Values (n, c) of a group of readings; None where channels differ."""
    places = members(data.session, group)
    if len(places) != len(group) * len(channels):
        return None
    table = places.reshape(len(group), len(channels))
    same = (data.channel[table] == np.array(channels)).all()
    return table if same else None


def _ordered(
    scope: Scope, tables: list[Index], subject: str, *, is_alone: bool = False
) -> Iterator[MistakeTrial]:
    """Rows of values (n, c), alone in their readings or not, put as expected."""
    data, session = scope.data, scope.session
    y = session.y.copy()
    for _ in range(6):
        predicted = _predicted(data, y, np.concatenate(tables).ravel())
        before = y.copy()
        for table in tables:
            spread = data.spread[table].max(axis=0)
            source = _matching(predicted[table] / spread, session.y[table] / spread)
            y[table] = session.y[table[source]]
        if np.array_equal(y, before):
            break
    columns = [[table[:, k] for table in tables] for k in range(tables[0].shape[1])]
    sorted_by = [w for c in columns if (w := _order(data, c)) != UNKNOWN_ORDER]
    text = f"{subject} are {(sorted_by or [UNKNOWN_ORDER])[0]}"
    if not np.array_equal(y, session.y):
        kind = "sorting" if sorted_by else "disorder"
        orders = sum(scipy.special.gammaln(1.0 + len(table)) for table in tables)
        log_prior = 0.0 if sorted_by else -float(orders)
        yield value_trial(scope, kind, text, y, log_prior=log_prior)
    if sorted_by and is_alone:
        yield _distribution_alone(scope, tables, text)


def _matching(expected: Array, values: Array) -> Index:
    """Rows of values (n, c) that belong to expected ones, by their rank or an assignment."""
    if expected.shape[1] == 1:
        source = np.empty(len(values), dtype=np.intp)
        source[np.argsort(expected[:, 0])] = np.argsort(values[:, 0])
        return source
    cost = ((expected[:, None] - values[None]) ** 2).sum(axis=2)
    return np.asarray(scipy.optimize.linear_sum_assignment(cost)[1])


def _order(data: Suspect, groups: list[Index]) -> str:
    """Whether all groups of values are sorted, and how."""
    y = data.session.y
    for text, key in (
        ("sorted by size", y),
        ("sorted by size, the largest first", -y),
        ("sorted by size without their sign", np.abs(y)),
    ):
        steps = [np.diff(key[places]) for places in groups]
        if all((step >= 0.0).all() for step in steps) and any(s.any() for s in steps):
            return text
    return UNKNOWN_ORDER


def _predicted(data: Suspect, y: Array, places: Index) -> Array:
    """Values (N,) predicted by those that are not in `places`; by all where these are
    most.
    """
    used = np.ones(len(y), dtype=bool)
    used[places] = False
    if used.sum() < len(places):
        used[:] = True
    white = (y - data.predicted) / data.sigma
    slopes = data.slopes / data.sigma[:, None]
    part = slopes[used]
    precision = part.T @ part + np.eye(part.shape[1])
    z = np.linalg.solve(precision, part.T @ white[used])
    return data.predicted + data.slopes @ z


def _distribution_alone(
    scope: Scope, tables: list[Index], sentence: str
) -> MistakeTrial:
    """Sorted values of which nothing but the distribution is used: a normal one."""
    data = scope.data
    missing = np.isin(np.arange(len(data.session)), np.concatenate(tables))
    log_density = 0.0
    for table in tables:
        y = data.session.y[table]
        count = len(table)
        sd = max(float(np.std(y)), float(np.median(data.sigma[table])))
        log_density += float(scipy.special.gammaln(1.0 + count))
        log_density -= count * (np.log(sd) + 0.5 * np.log(2.0 * np.pi) + 0.5)
    return value_trial(
        scope, "sorting", sentence, missing=missing, log_missing=log_density
    )
