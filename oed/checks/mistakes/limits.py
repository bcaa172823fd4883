"""Readings beyond what an instrument shows: clipped at its range, or turned round once
more without being counted.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from oed.base import Array, Mask
from oed.checks.copies import resolution
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    log_density_of_known,
    mistakes_of_values,
    value_trial,
)

#: what a dial shows in one revolution, by SI unit
REVOLUTIONS = {"m": (1e-3, 0.1e-3, 0.2e-3, 10e-3), "rad": (2.0 * np.pi, np.pi)}
REVOLUTION_SD = 8.0  #: noise from which on a revolution is told from it
MIN_DIVISIONS = 10.0  #: divisions of a dial, at least


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Readings at the ends of a range, and revolutions."""
    yield from mistakes_of_values(data, _clipped)
    for si, turns in REVOLUTIONS.items():
        for turn in turns:
            yield from mistakes_of_values(data, partial(_revolved, si, turn))


def _clipped(scope: Scope) -> MistakeTrial | None:
    """Values at the largest or smallest one of a channel, which others equal."""
    session, values = scope.session, scope.values
    if len(scope.channels) > 1 or scope.level == "rows":
        return None
    y = session.y
    ends = []
    missing = np.zeros(len(session), dtype=bool)
    for end in (y[values].min(), y[values].max()):
        at_end = values & (y == end)
        if at_end.sum() >= 3:
            missing |= at_end
            ends.append(session.written(scope.channels[0], float(end)))
    if not ends or (missing == values).all():
        return None
    sentence = (
        f"{scope.columns_within} stops at {' and '.join(ends)}, the ends of"
        " the instrument's range: readings beyond are clipped"
    )
    log_missing = log_density_of_known(scope.data, missing, values)
    log_missing -= float(missing.sum() * np.log(2.0))
    return value_trial(
        scope, "limits", sentence, missing=missing, log_missing=log_missing
    )


# -- revolutions -----------------------------------------------------------------------
def _revolved(si: str, turn: float, scope: Scope) -> MistakeTrial | None:
    """Values with the whole revolutions that the others of the session expect."""
    data, session, values = scope.data, scope.session, scope.values
    base = data.bases(values).get("the nominal machine")
    if not scope.is_of(si) or scope.level == "rows" or base is None:
        return None
    away = session.y - base
    is_in_one = np.ptp(away[values]) <= turn or np.abs(session.y[values]).max() <= turn
    step = resolution(session, np.flatnonzero(values))
    if not is_in_one or turn < max(
        REVOLUTION_SD * data.sigma[values].max(), MIN_DIVISIONS * step
    ):
        return None
    counts = _counts(data, values, away, turn)
    if np.ptp(counts[values]) == 0.0:  # one shift of all is no dial that goes round
        return None
    y = session.y + np.where(values, turn * counts, 0.0)
    shown = f"{turn * 1e3:g} mm" if si == "m" else f"{np.rad2deg(turn):g} deg"
    sentence = (
        f"whole revolutions of {scope.columns_within} are not counted: the"
        f" deviations begin again after {shown}"
    )
    return value_trial(scope, "limits", sentence, y)


def _counts(data: Suspect, values: Mask, away: Array, turn: float) -> Array:
    """Revolutions (N,) by which each value, the best predicted first, is expected."""
    counts = np.zeros(len(away))
    precision = np.eye(data.slopes.shape[1])
    others = np.flatnonzero(~values)
    slopes = data.slopes / data.sigma[:, None]
    part = slopes[others]
    covariance = np.linalg.inv(precision + part.T @ part)
    mean = covariance @ (part.T @ (away[others] / data.sigma[others]))
    inside = np.flatnonzero(values)
    rows = data.slopes[inside]
    predicted, shared = rows @ mean, rows @ covariance @ rows.T
    is_left = np.ones(len(inside), dtype=bool)
    while is_left.any():
        nearest = int(np.argmin(np.where(is_left, np.diagonal(shared), np.inf)))
        is_left[nearest] = False
        k = inside[nearest]
        counts[k] = np.round((predicted[nearest] - away[k]) / turn)
        gain = shared[nearest] / (shared[nearest, nearest] + data.sigma[k] ** 2)
        predicted += gain * (away[k] + turn * counts[k] - predicted[nearest])
        shared -= np.outer(gain, shared[nearest])
    return counts
