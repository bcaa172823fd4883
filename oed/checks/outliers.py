"""Outliers: readings that all others together contradict, named row by row.

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

from oed.arrays import Array, Index
from oed.checks.fit import (
    Fit,
    LeaveOneOut,
    fit,
    predict_from_others,
)
from oed.checks.outlier_sets import best_set
from oed.checks.session import SessionReadings
from oed.kinematics import AssemblyError

#: probability that a correct session has an outlier
FALSE_ALARM = 1e-4
#: largest share of the readings that can be outliers, and their number in small sessions
SHARE, LEAST = 0.12, 3
#: rounds of fit and search
ROUNDS = 5
#: median of a standard normal variable's absolute value
MEDIAN = float(-special.ndtri(0.25))


@dataclasses.dataclass(frozen=True)
class OutlierSearch:
    """Readings far from what all others predict.

    readings   numbers of the readings, the farthest first
    pulls      how far each is, in standard deviations of its prediction
    errors     how far each is, SI, of the value that is farthest
    values     number of that value
    solution   fit of the other readings
    exhausted  whether more readings deviate than can be outliers
    """

    readings: tuple[int, ...]
    pulls: tuple[float, ...]
    errors: tuple[float, ...]
    values: tuple[int, ...]
    solution: Fit
    exhausted: bool


def find_outliers(
    session: SessionReadings, suspects: Index, *, robust: bool = False
) -> OutlierSearch | None:
    """Outliers of a session; None where it cannot be fitted.

    `suspects` are readings, by number, to leave out of the first fit. With `robust`,
    deviations count in units of their own scatter where it exceeds the stated noise;
    without it they do so only where too many deviate.
    """
    count = 1 + int(session.reading_of_value[-1])
    most = min(max(LEAST, int(SHARE * count)), count // 4)
    if len(suspects) > most:
        suspects = suspects[:0]
    readings = sorted({int(k) for k in suspects})
    solution = fit(session.without(readings))
    for _ in range(ROUNDS):
        on_all = None if solution is None else _on_all(session, solution)
        if on_all is None or solution is None:
            return None
        prediction = predict_from_others(on_all)
        newer, exhausted = _search(session, prediction, most, readings, robust=robust)
        if exhausted and not robust:
            newer, exhausted = _search(session, prediction, most, readings, robust=True)
        elif len(newer) <= most:
            reading = session.reading_of_value
            newer = best_set(prediction, reading, newer, _limit(reading))[:most]
        if set(newer) == set(readings) or exhausted:
            break
        readings = newer
        solution = fit(session.without(readings), solution.theta)
    if solution is None:
        return None
    return _outliers(session, prediction, readings, solution, exhausted)


def _on_all(session: SessionReadings, solution: Fit) -> Fit | None:
    """The model of a fit at its solution, for all readings of the session.

    None where the fitted machine cannot take the poses that were left out of the fit.
    """
    measurement, series = session.measurement, session.series
    noise = measurement.noise(series)
    free = np.flatnonzero(measurement.free)
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
        slopes=noise.whiten(measurement.in_prior_units(jacobian)[:, free]),
        noise=noise,
    )


def _search(
    session: SessionReadings,
    prediction: LeaveOneOut,
    most: int,
    first: list[int],
    *,
    robust: bool = False,
) -> tuple[list[int], bool]:
    """Readings to leave out, and whether too many deviate.

    With `robust`, pulls are in units of their own scatter where it exceeds the noise.
    """
    reading = session.reading_of_value
    limit = _limit(reading)
    removed = list(first)
    while True:
        pulls = _pulls(prediction, reading, removed, robust=robust)
        worst = int(np.argmax(np.abs(pulls)))
        if abs(pulls[worst]) <= limit:
            break
        if len(removed) >= most:
            return removed, True
        removed.append(int(reading[worst]))
    for one in list(removed):
        others = [k for k in removed if k != one]
        pulls = _pulls(prediction, reading, others, robust=robust)
        if np.abs(pulls[reading == one]).max() <= limit:
            removed = others
    return removed, False


def _limit(reading: Index) -> float:
    """Pull beyond which a reading counts as an outlier."""
    return float(-special.ndtri(0.5 * FALSE_ALARM / len(reading)))


def _pulls(
    prediction: LeaveOneOut, reading: Index, removed: list[int], *, robust: bool
) -> Array:
    """Pulls (N,) from what the readings not removed predict; 0 for those removed."""
    members = np.flatnonzero(np.isin(reading, removed))
    gradient, diagonal = prediction.without(members)
    pulls = gradient / np.sqrt(diagonal)
    if not robust:
        return np.asarray(pulls)
    others = np.setdiff1d(np.arange(len(reading)), members)
    scatter = float(np.median(np.abs(pulls[others]))) / MEDIAN
    return np.asarray(pulls / max(scatter, 1.0))


def _outliers(
    session: SessionReadings,
    prediction: LeaveOneOut,
    readings: list[int],
    solution: Fit,
    exhausted: bool,
) -> OutlierSearch:
    reading = session.reading_of_value
    records = []
    for one in readings:
        others = [k for k in readings if k != one]
        members = np.flatnonzero(np.isin(reading, others))
        gradient, diagonal = prediction.without(members)
        pulls = gradient / np.sqrt(diagonal)
        members_of_one = np.flatnonzero(reading == one)
        worst = int(members_of_one[np.argmax(np.abs(pulls[members_of_one]))])
        error = float(gradient[worst] / diagonal[worst])
        records.append((one, float(pulls[worst]), error, worst))
    records.sort(key=lambda record: -abs(record[1]))
    return OutlierSearch(
        readings=tuple(r[0] for r in records),
        pulls=tuple(r[1] for r in records),
        errors=tuple(r[2] for r in records),
        values=tuple(r[3] for r in records),
        solution=solution,
        exhausted=exhausted,
    )
