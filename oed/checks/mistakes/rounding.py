"""Commands rounded in the file: the machine stood where finer numbers said.

Each reading has an error more, its slope over the coordinate times a number that is
uniform over the rounding step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base.arrays import Array, Mask
from oed.checks.mistakes.driven import commanded, shifted
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import pose_table
from oed.checks.mistakes.pose import SLACK
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, in_scopes, plain
from oed.checks.session import SessionReadings
from oed.dataset.columns import parse_column

#: decimals that a column has where it is rounded, from tens on
DECIMALS = range(-1, 4)
#: values of which a rounded column has more than so many
LEAST_VALUES = 4
#: share of a rounding step that is looked at for slopes
STEP = 1e-3
#: error of rounding, over the noise, from which on it matters
MATTERS = 3.0
#: log prior: most columns of whole numbers were driven so
SELDOM = -2.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each column of whole numbers, or of few decimals, whose decimals were lost."""
    measurement = given.session.measurement
    for k, (name, values) in enumerate(given.columns.items()):
        decimals = _decimals(values)
        if decimals is None:
            continue
        step = 10.0**-decimals
        change = shifted(k, STEP * step * parse_column(name).factor)
        table = pose_table(given, commanded(measurement, change, slack=SLACK))
        if table is None:
            continue
        slope = np.nan_to_num(table.predicted - given.predicted) / STEP
        error = np.abs(slope) / np.sqrt(12.0)
        if (error > MATTERS * given.sigma).any():
            words = f"{name}{{}} is rounded to {step:g}: finer numbers were driven"
            on = partial(_rounded, given, words, error)
            yield from in_scopes(given.scopes, on)


def _decimals(values: Array) -> int | None:
    """Decimals of a column (n,) in its unit; None where it has many, or few values."""
    if not np.isfinite(values).all() or len(np.unique(values)) <= LEAST_VALUES:
        return None
    for decimals in DECIMALS:
        if np.allclose(values, np.round(values, decimals), rtol=0.0, atol=1e-9):
            return decimals
    return None


def _rounded(given: Given, words: str, error: Array, scope: Scope) -> MistakeTrial:
    at = scope.values(given.session)
    factor = np.where(at, np.hypot(1.0, error / given.sigma), 1.0)
    return MistakeTrial(
        kind="rounded",
        scope=scope,
        words=plain(words.format(scope.within)),
        undo=lambda amounts: [_with_sigma(given.session, given.sigma * factor, at)],
        log_prior=SELDOM,
        noise=factor,
    )


def _with_sigma(session: SessionReadings, sigma: Array, at: Mask) -> SessionReadings:
    """The session with other standard deviations (N,) in some values."""
    series = []
    for s, span in zip(session.series, session.spans, strict=True):
        stated = np.where(at[span], sigma[span], session.measurement.sigma([s]))
        series.append(dataclasses.replace(s, sigma=stated.reshape(len(s), -1)))
    return dataclasses.replace(session, series=tuple(series))
