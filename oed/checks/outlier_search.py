"""Search of readings beyond the limit of what all others predict.

Forward search: the reading with the largest pull is left out, and those that remain
predict it anew, until none exceeds the limit. Then each one left out is tested again
against the rest, and few are compared with other sets of few (`outlier_sets`). Pulls are
in units of the stated noise. Where too many exceed the limit, a robust estimate of their
scatter is the unit: noise that is larger everywhere is no outlier.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from oed.base.arrays import Array, Index
from oed.checks.far_reading import LeaveOneOut, predict_from_others
from oed.checks.fit import Fit, fit
from oed.checks.outlier_sets import best_set
from oed.checks.session import SessionReadings
from oed.mechanism.kinematics import AssemblyError

#: probability that a correct session has a reading beyond the limit
FALSE_ALARM = 1e-4
#: rounds of fit and search
ROUNDS = 5
#: median of a standard normal variable's absolute value
MEDIAN = float(-special.ndtri(0.25))


@dataclasses.dataclass(frozen=True)
class FarSearch:
    """Readings beyond the limit, the fit of all others, and what it predicts."""

    readings: list[int]
    solution: Fit
    prediction: LeaveOneOut
    exhausted: bool


def far_readings(
    session: SessionReadings, suspects: Index, most: int, *, robust: bool
) -> FarSearch | None:
    """The forward search, and the fit of what it leaves; None where there is no fit.

    suspects  readings, by number, to leave out of the first fit
    most      number of readings that can be outliers
    robust    whether deviations count in units of their own scatter
    """
    readings = sorted({int(k) for k in suspects})
    solution = fit(session.without(readings))
    for _ in range(ROUNDS):
        whole = None if solution is None else _on_all(session, solution)
        if whole is None or solution is None:
            return None
        prediction = predict_from_others(whole)
        newer, exhausted = _search(prediction, most, readings, robust=robust)
        if exhausted and not robust:
            newer, exhausted = _search(prediction, most, readings, robust=True)
        if not exhausted and len(newer) <= most:
            # few that hide each other make many of the others deviate
            newer = best_set(prediction, newer, _limit(prediction))[:most]
        if set(newer) == set(readings) or exhausted:
            break
        readings = newer
        solution = fit(session.without(readings), solution.theta)
    if solution is None:
        return None
    return FarSearch(readings, solution, prediction, exhausted)


def _on_all(session: SessionReadings, solution: Fit) -> Fit | None:
    """The model of a fit at its solution, for all readings of the session.

    None where the fitted machine cannot take the poses that were left out of the fit.
    """
    measurement, series = session.measurement, session.series
    noise = session.noise()
    try:
        difference = session.y - measurement.readings(series, solution.theta)
        jacobian = measurement.jacobian(series, solution.theta)
    except AssemblyError:
        return None
    residual = noise.whiten(difference)
    return dataclasses.replace(
        solution,
        session=session,
        residual=residual,
        slopes=noise.whiten(jacobian @ session.prior_root()),
        noise=noise,
    )


def _search(
    prediction: LeaveOneOut, most: int, first: list[int], *, robust: bool
) -> tuple[list[int], bool]:
    """Readings to leave out, and whether too many deviate.

    With `robust`, pulls are in units of their own scatter where it exceeds the noise.
    """
    reading = prediction.reading
    limit = _limit(prediction)
    removed = list(first)
    while True:
        pulls = _pulls(prediction, removed, robust=robust)
        worst = int(np.argmax(np.abs(pulls)))
        if abs(pulls[worst]) <= limit:
            break
        if len(removed) >= most:
            return removed, True
        removed.append(int(reading[worst]))
    for one in list(removed):
        others = [k for k in removed if k != one]
        pulls = _pulls(prediction, others, robust=robust)
        if np.abs(pulls[reading == one]).max() <= limit:
            removed = others
    return removed, False


def _limit(prediction: LeaveOneOut) -> float:
    """Pull beyond which a reading counts as an outlier."""
    return float(-special.ndtri(0.5 * FALSE_ALARM / len(prediction.reading)))


def _pulls(prediction: LeaveOneOut, removed: list[int], *, robust: bool) -> Array:
    """Pulls (N,) from what the readings not removed predict; 0 for those removed."""
    gradient, diagonal = prediction.without(removed)
    pulls = gradient / np.sqrt(diagonal)
    if not robust:
        return pulls
    others = ~np.isin(prediction.reading, removed)
    scatter = float(np.median(np.abs(pulls[others]))) / MEDIAN
    return pulls / max(scatter, 1.0)
