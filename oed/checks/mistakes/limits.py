"""Readings beyond what an instrument shows: clipped at its range, or turned round once
more without being counted; and a noise that is stated in another unit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy import special

from oed.base.arrays import Array, Mask
from oed.checks.copies import resolution
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, in_values, plain, value_trial
from oed.checks.session import SessionReadings

#: readings at an end from which on it is one of the instrument's range
LEAST_AT_END = 3
#: step of readings with more digits than are looked at, in their noise
FINEST = 1e-6
#: what a dial shows in one revolution, by SI unit
REVOLUTIONS = {"m": (1e-3, 0.1e-3, 0.2e-3, 10e-3), "rad": (2.0 * np.pi, np.pi)}
#: noise from which on a revolution is told from it
SURE = 8.0
#: divisions of a dial, at least
DIVISIONS = 10.0
#: noise over that which is stated: another unit, by SI unit
OTHER_NOISE = {"m": (1e3, 1e-3, 1e6, 1e-6), "rad": (3600.0, 1.0 / 3600.0, 1e3, 1e-3)}
#: level at which residuals depend on the pose, so that they are no noise
TREND = 1e-4
#: log prior of another noise: misfits of an effect look like noise as well
SELDOM = -3.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings at the ends of a range, revolutions, and noise in another unit."""
    yield from in_values(given, partial(_clipped, given))
    for si, turns in REVOLUTIONS.items():
        for turn in turns:
            yield from in_values(given, partial(_revolved, given, si, turn))
    yield from noise_trials(given)


def noise_trials(given: Given) -> Iterator[MistakeTrial]:
    """Noise that is stated in another unit."""
    for si, factors in OTHER_NOISE.items():
        for factor in factors:
            yield from in_values(given, partial(_other_noise, given, si, factor))


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
    step = resolution(session, np.flatnonzero(values))
    size = np.maximum(step, FINEST * given.sigma[missing])
    dropped = np.unique(session.reading_of_value[missing]).tolist()
    sentence = (
        f"{given.names(values)}{scope.within} stops at {' and '.join(ends)}, the ends of"
        " the instrument's range: readings beyond are clipped"
    )
    return MistakeTrial(
        kind="limits",
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [session.without(dropped)],
        missing=missing,
        log_missing=-float(np.log(2.0 * size).sum()),
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


# -- noise -----------------------------------------------------------------------------


def _other_noise(
    given: Given, si: str, factor: float, scope: Scope, values: Mask
) -> MistakeTrial | None:
    """All readings of a unit with another noise than stated."""
    session = given.session
    of_unit = given.shown & (given.unit == si)
    if scope.level != "file" or not np.array_equal(values, of_unit):
        return None
    if factor > 1.0 and _depends_on_pose(given, values, factor):
        return None
    channel = str(given.channel[values][0])
    stated = float(np.median(given.sigma[values]))
    sentence = (
        f"the noise of {given.names(values)} is stated in another unit: {factor:g} times"
        f" the {session.fine(channel, stated)} that are stated explain the readings"
    )
    return MistakeTrial(
        kind="noise",
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [_with_noise(session, si, factor)],
        log_prior=SELDOM,
        noise=np.where(values, factor, 1.0),
    )


def _depends_on_pose(given: Given, values: Mask, factor: float) -> bool:
    """Whether what a fit with more noise leaves is a smooth function of the commands.

    An F test of second-order polynomials, channel by channel: noise has no such part.
    """
    base = given.bases(values).get("the nominal machine")
    if base is None:
        return False
    sigma = factor * given.sigma[values]
    white = given.slopes[values] / sigma[:, None]
    away = (given.session.y - base)[values] / sigma
    precision = np.eye(white.shape[1]) + white.T @ white
    residual = away - white @ np.linalg.solve(precision, white.T @ away)
    channels = given.channel[values]
    commands = given.command[given.session.reading_of_value[values]]
    return any(
        _trend_p_value(commands[at], residual[at]) < TREND
        for at in (channels == name for name in dict.fromkeys(channels))
    )


def _trend_p_value(commands: Array, residual: Array) -> float:
    """Probability of a polynomial as large as that in residuals (n,), were they noise.

    commands  (n, n_dof) of the values
    """
    varied = commands[:, np.ptp(commands, axis=0) > 0.0]
    scaled = (varied - varied.mean(axis=0)) / np.maximum(varied.std(axis=0), 1e-300)
    i, j = np.triu_indices(scaled.shape[1])
    terms = np.column_stack([np.ones(len(scaled)), scaled, scaled[:, i] * scaled[:, j]])
    basis = np.linalg.svd(terms, full_matrices=False)[0][
        :, : np.linalg.matrix_rank(terms)
    ]
    freedom = len(residual) - basis.shape[1]
    if freedom < basis.shape[1]:
        return 1.0
    explained = float(np.sum((basis.T @ residual) ** 2))
    rest = float(residual @ residual) - explained
    ratio = explained / basis.shape[1] / max(rest / freedom, 1e-300)
    return float(special.fdtrc(basis.shape[1], freedom, ratio))


def _with_noise(session: SessionReadings, si: str, factor: float) -> SessionReadings:
    """The session whose channels of a unit have their noise times a factor."""
    setups = []
    for setup in session.measurement.setups.values():
        pairs = zip(setup.sigma, setup.instrument.channels, strict=True)
        sigma = tuple(s * factor if c.unit == si else s for s, c in pairs)
        setups.append(dataclasses.replace(setup, sigma=sigma))
    measurement = session.measurement.with_setups(setups)
    return dataclasses.replace(session, measurement=measurement)
