"""Drift of a machine over its sessions: a straight line for each combination.

With p(t) = a + v (t - t_last) the drift v is the change per unit of time of
`oed.estimation.session_change`, and of two sessions it is that of `oed.estimation.session_change.compare`.
What the line leaves of the sessions is chi2 as well: a machine that was knocked does
not drift.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import optimize, stats

from oed.base.arrays import Array
from oed.base.linear_algebra import covariance_root
from oed.estimation.session_change import (
    CombinationChange,
    Session,
    combinations,
    estimate_change,
    likelihood,
)

#: probability of proving a drift that is called provable, and directions of drift that
#: it is a mean over; natural logarithm of how far the provable drift is sought
POWER, DIRECTIONS, SPREAD = 0.9, 200, 12.0
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
    change = estimate_change(sessions, nominal, tolerance, since / span)
    root, white, dof = change.root, change.white, change.dof
    rest, rest_dof = change.rest, change.rest_dof
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
        chi2=change.chi2,
        dof=dof,
        p_value=_p_value(change.chi2, dof, widening),
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


def provable_growth(
    maps: Array,
    sessions: Sequence[Session],
    nominal: Array,
    tolerance: Array,
    counts: Sequence[int],
    alarm: float,
    rng: np.random.Generator,
) -> Array:
    """Growth (len(counts),) of an rms error, SI a session, that so many sessions prove.

    maps    (m, np) pose errors per parameter
    counts  of equally spaced sessions, each with the mean information of those given
    alarm   probability of a false alarm

    The drift's direction is random in the tolerances. Its proof has the probability
    POWER, by the noncentral chi2 of the test: n sessions have the information L n (n^2 -
    1) / 12 of the change between two of them, L that of one.
    """
    roots = [likelihood(s, nominal, tolerance)[0] for s in sessions]
    _, singular, right = np.linalg.svd(np.vstack(roots), full_matrices=False)
    informed = singular >= np.sqrt(len(sessions))
    root = singular[informed, None] / np.sqrt(len(sessions)) * right[informed]
    direction = rng.standard_normal((DIRECTIONS, int(informed.sum()))) @ right[informed]
    growth = np.sqrt(np.mean((direction * tolerance @ maps.T) ** 2, axis=1))
    information = np.sum((direction @ root.T) ** 2, axis=1) / growth**2
    dof = int(informed.sum())
    critical = stats.chi2.isf(alarm, dof)

    def excess(log_growth: float, count: int) -> float:
        times = count * (count**2 - 1) / 12.0
        squared = np.exp(2.0 * log_growth) * information * times
        return float(np.mean(stats.ncx2.sf(critical, dof, squared)) - POWER)

    usual = -0.5 * float(np.median(np.log(information)))
    bracket = (usual - SPREAD, usual + SPREAD)
    solutions = [optimize.brentq(excess, *bracket, args=(n,)) for n in counts]
    return np.exp(solutions)


@dataclasses.dataclass(frozen=True, slots=True)
class NextCalibration:
    """When the error reaches its limit, in time after the last session.

    time       median over the drifts that the sessions allow; inf where it never does
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
    root = covariance_root(drifted.covariance)
    normal = rng.standard_normal((draws, len(drifted.rate)))
    rates = drifted.rate + normal @ root.T
    growth = np.sqrt(np.mean((rates @ maps.T) ** 2, axis=1))
    room = np.sqrt(max(limit**2 - after**2, 0.0))
    with np.errstate(divide="ignore"):
        times = room / growth
    low, median, high = np.quantile(times, [0.025, 0.5, 0.975], method="lower")
    return NextCalibration(float(median), float(low), float(high))
