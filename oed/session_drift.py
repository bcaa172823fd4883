"""Drift of a machine over its sessions: a straight line for each combination.

Session k at time t_k has information L_k and score b_k of its readings alone
(`oed.session_change`). With p(t) = a + v (t - t_last) and nothing assumed about a, the
drift v has

    information  P = sum s^2 L - C A^+ C,     A = sum L,  C = sum s L,  s = t - t_last
    score        h = sum s b - C A^+ sum b

and chi2 = h' P^+ h where nothing drifts. What the line leaves of the sessions is chi2 as
well: a machine that was knocked does not drift.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg, stats

from oed.arrays import Array
from oed.session_change import (
    CombinationChange,
    Session,
    combinations,
    determined_directions,
    likelihood,
)

#: p-value below which the sessions do not lie on a line, and intervals are widened
UNEVEN = 0.01


@dataclasses.dataclass(frozen=True, slots=True)
class SessionDrift:
    """Drift over the sessions, per unit of time, in the units of the parameters.

    chi2, dof, p_value  test of no drift at all
    rest, rest_dof      chi2 of what a line leaves, and its degrees of freedom
    widening            factor on all standard deviations where a line does not suit
    combinations        that the sessions determine, the surest drift first
    rate                (n,) drift of each parameter; 0 along undetermined directions
    covariance          (n, n) of `rate`, widened
    undetermined        number of directions whose drift stays unseen
    """

    chi2: float
    dof: int
    p_value: float
    rest: float
    rest_dof: int
    widening: float
    combinations: tuple[CombinationChange, ...]
    rate: Array
    covariance: Array
    undetermined: int


def drift(
    names: Sequence[str],
    nominal: Array,
    tolerance: Array,
    sessions: Sequence[Session],
    times: Array,
) -> SessionDrift:
    """Drift of parameters (n,) over sessions at times (k,), priors as in `compare`.

    Raises ValueError for fewer than two different times.
    """
    since = np.asarray(times, dtype=float) - np.max(times)
    span = float(np.ptp(since))
    if span <= 0.0:
        raise ValueError("a drift needs sessions at two different times")
    elapsed = since / span
    parts = [likelihood(s, nominal, tolerance) for s in sessions]
    level = sum(information for information, _ in parts)
    cross = sum(
        e * information for e, (information, _) in zip(elapsed, parts, strict=True)
    )
    square = sum(
        e**2 * information for e, (information, _) in zip(elapsed, parts, strict=True)
    )
    score = np.sum([b for _, b in parts], axis=0)
    moment = np.sum([e * b for e, (_, b) in zip(elapsed, parts, strict=True)], axis=0)
    inverse = linalg.pinvh(level)
    information = square - cross @ inverse @ cross
    directions = determined_directions(information, moment - cross @ inverse @ score)
    root, white = directions
    chi2, dof = float(white @ white), len(white)
    rest, rest_dof = _rest(parts, score, inverse, chi2, dof)
    uneven = rest_dof > 0 and stats.chi2.sf(rest, rest_dof) < UNEVEN
    widening = float(np.sqrt(rest / rest_dof)) if uneven else 1.0
    scale = tolerance / span
    back = np.linalg.pinv(root) if dof else np.zeros((len(tolerance), 0))
    covariance = widening**2 * back @ back.T * np.outer(scale, scale)
    rates = [
        _per_time(c, span, widening)
        for c in combinations(names, tolerance, root, white)
    ]
    return SessionDrift(
        chi2=chi2,
        dof=dof,
        p_value=_p_value(chi2, dof, widening),
        rest=rest,
        rest_dof=rest_dof,
        widening=widening,
        combinations=tuple(rates),
        rate=(back @ white) * scale,
        covariance=covariance,
        undetermined=len(tolerance) - dof,
    )


def _p_value(chi2: float, dof: int, widening: float) -> float:
    return float(stats.chi2.sf(chi2 / widening**2, dof)) if dof else 1.0


def _per_time(
    change: CombinationChange, span: float, widening: float
) -> CombinationChange:
    """A change over the whole span as a rate."""
    rate, sd = change.change / span, widening * change.sd / span
    return CombinationChange(
        change.coefficients, rate, sd, float(2.0 * stats.norm.sf(abs(rate / sd)))
    )


def _rest(
    parts: Sequence[tuple[Array, Array]],
    score: Array,
    inverse: Array,
    explained: float,
    dof: int,
) -> tuple[float, int]:
    """Chi2 of the sessions about their line, and its degrees of freedom."""
    total, rank = 0.0, 0
    for information, b in parts:
        total += float(b @ linalg.pinvh(information) @ b)
        rank += int(np.linalg.matrix_rank(information, hermitian=True))
    common = float(score @ inverse @ score)
    used = int(np.linalg.matrix_rank(inverse, hermitian=True)) + dof
    return max(total - common - explained, 0.0), max(rank - used, 0)


@dataclasses.dataclass(frozen=True, slots=True)
class NextCalibration:
    """When the error reaches its limit, in time after the last session.

    time       with the estimated drift; inf where it never does
    low, high  95 % interval
    """

    time: float
    low: float
    high: float


def next_calibration(
    maps: Array,
    drifted: SessionDrift,
    after: float,
    limit: float,
    rng: np.random.Generator,
    draws: int = 4000,
) -> NextCalibration:
    """When the rms error of a component over the workspace exceeds a limit, SI.

    maps   (m, np) pose errors per parameter, in the order of the drift's names
    after  rms error right after the last calibration

    With the drift v the squared rms error is after^2 + t^2 mean (maps v)^2.
    """
    values, vectors = np.linalg.eigh(drifted.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = rng.standard_normal((draws, len(drifted.rate)))
    rates = np.vstack([drifted.rate, drifted.rate + normal @ root.T])
    growth = np.sqrt(np.mean((rates @ maps.T) ** 2, axis=1))
    room = np.sqrt(max(limit**2 - after**2, 0.0))
    with np.errstate(divide="ignore"):
        times = room / growth
    low, high = np.quantile(times[1:], [0.025, 0.975])
    return NextCalibration(float(times[0]), float(low), float(high))
