"""Readings beyond what an instrument shows: clipped at its range, or turned round once
more without being counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base import Array, Mask
from oed.checks.copies import resolution
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import (
    MistakeTrial,
    in_values,
    log_density_of_known,
    value_trial,
)

#: readings at an end from which on it is one of the instrument's range
LEAST_AT_END = 3
#: what a dial shows in one revolution, by SI unit
REVOLUTIONS = {"m": (1e-3, 0.1e-3, 0.2e-3, 10e-3), "rad": (2.0 * np.pi, np.pi)}
#: noise from which on a revolution is told from it
SURE = 8.0
#: divisions of a dial, at least
DIVISIONS = 10.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings at the ends of a range, and revolutions."""
    yield from in_values(given, partial(_clipped, given))
    for si, turns in REVOLUTIONS.items():
        for turn in turns:
            yield from in_values(given, partial(_revolved, given, si, turn))


def _clipped(given: Given, scope: Scope, values: Mask) -> MistakeTrial | None:
    """Values at the largest or smallest one of a channel, which others equal."""
    session = given.session
    if len(set(given.channel[values])) > 1 or scope.level == "rows":
        return None
    y, ends = session.y, []
    missing = np.zeros(len(session), dtype=bool)
    for end in (y[values].min(), y[values].max()):
        at = values & (y == end)
        if at.sum() >= LEAST_AT_END:
            missing |= at
            ends.append(session.written(str(given.channel[values][0]), float(end)))
    if not ends or (missing == values).all():
        return None
    sentence = (
        f"{given.names(values)}{scope.within} stops at {' and '.join(ends)}, the ends of"
        " the instrument's range: readings beyond are clipped"
    )
    log_missing = log_density_of_known(given, missing, values)
    log_missing -= float(missing.sum() * np.log(2.0))
    return value_trial(
        session,
        "limits",
        scope,
        sentence,
        missing=missing,
        log_missing=log_missing,
    )


# -- revolutions -----------------------------------------------------------------------


def _revolved(
    given: Given, si: str, turn: float, scope: Scope, values: Mask
) -> MistakeTrial | None:
    """Values with the whole revolutions that the others of the session expect."""
    session = given.session
    base = given.bases(values).get("the nominal machine")
    if set(given.unit[values]) != {si} or scope.level == "rows" or base is None:
        return None
    away = session.y - base
    is_in_one = np.ptp(away[values]) <= turn or np.abs(session.y[values]).max() <= turn
    step = resolution(session, np.flatnonzero(values))
    if not is_in_one or turn < max(SURE * given.sigma[values].max(), DIVISIONS * step):
        return None
    counts = _counts(given, values, away, turn)
    if np.ptp(counts[values]) == 0.0:  # one shift of all is no dial that goes round
        return None
    y = session.y + np.where(values, turn * counts, 0.0)
    shown = f"{turn * 1e3:g} mm" if si == "m" else f"{np.rad2deg(turn):g} deg"
    sentence = (
        f"whole revolutions of {given.names(values)}{scope.within} are not counted: the"
        f" deviations begin again after {shown}"
    )
    return value_trial(session, "limits", scope, sentence, y)


def _counts(given: Given, values: Mask, away: Array, turn: float) -> Array:
    """Revolutions (N,) that make each value what those before it predict.

    Values outside a scope come first; each further one is that which is predicted best.
    """
    counts = np.zeros(len(away))
    precision = np.eye(given.slopes.shape[1])
    known = np.flatnonzero(~values)
    slopes = given.slopes / given.sigma[:, None]
    part = slopes[known]
    covariance = np.linalg.inv(precision + part.T @ part)
    mean = covariance @ (part.T @ (away[known] / given.sigma[known]))
    remaining = list(np.flatnonzero(values))
    while remaining:
        rows = given.slopes[remaining]
        spread = np.einsum("ij,jk,ik->i", rows, covariance, rows)
        at = int(np.argmin(spread))
        k = remaining.pop(at)
        counts[k] = np.round((rows[at] @ mean - away[k]) / turn)
        gain = covariance @ rows[at] / (spread[at] + given.sigma[k] ** 2)
        mean = mean + gain * (away[k] + turn * counts[k] - rows[at] @ mean)
        covariance = covariance - np.outer(gain, rows[at] @ covariance)
    return counts
