"""Outliers: readings that all others together contradict, named row by row.

A reading beyond the limit is set aside only where it is surely a gross
error and no noise, and surely this reading and no other (`outlier_odds`). One that may be
noise of heavy tails is doubtful and stays in the fit. Where one reading of several must
be wrong, they are unlocated: all stay in the fit, which is bad. Readings that are off
alike (`far_reading`) are no single errors, and show an effect to a diagnosis.

Forward search: the reading with the largest pull is left out, and those that remain
predict it anew, until none exceeds the limit. Then each one left out is tested again
against the rest, and few are compared with other sets of few (`outlier_odds`). Pulls are
in units of the stated noise. Where too many exceed the limit, a robust estimate of their
scatter is the unit: noise that is larger everywhere is no outlier.
"""

import dataclasses

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.checks.fit import Fit, fit, goodness
from oed.checks.outlier_odds import (
    GROSS_ODDS,
    LOCATED_ODDS,
    MAX_GROSS_SHARE,
    FarReading,
    LeaveOneOut,
    OutlierOdds,
    alike_readings,
    best_set,
    measure,
    predict_from_others,
)
from oed.checks.session import SessionReadings
from oed.mechanism import AssemblyError

#: probability that a correct session has a reading beyond the limit
OUTLIER_FALSE_ALARM = 1e-4
#: median of a standard normal variable's absolute value
MEDIAN_SIZE = float(-special.ndtri(0.25))


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
    """The forward search from suspects left out, for `most` outliers, and its fit."""
    readings = sorted({int(k) for k in suspects})
    solution = fit(session.without(readings))
    for _ in range(5):
        whole = None if solution is None else _extend_to_all(session, solution)
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


def _extend_to_all(session: SessionReadings, solution: Fit) -> Fit | None:
    """A fit's model for all readings; None where it cannot take poses left out."""
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
    """Readings to leave out, and whether too many deviate; see `far_readings`."""
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
    return float(-special.ndtri(0.5 * OUTLIER_FALSE_ALARM / len(prediction.reading)))


def _pulls(prediction: LeaveOneOut, removed: list[int], *, robust: bool) -> Array:
    """Pulls (N,) from what the readings not removed predict; 0 for those removed."""
    gradient, diagonal = prediction.without(removed)
    pulls = gradient / np.sqrt(diagonal)
    if not robust:
        return pulls
    others = ~np.isin(prediction.reading, removed)
    scatter = float(np.median(np.abs(pulls[others]))) / MEDIAN_SIZE
    return pulls / max(scatter, 1.0)


#: probability of larger residuals from which on the other readings fit the stated noise
SOUND_PROBABILITY = 0.01


@dataclasses.dataclass(frozen=True)
class OutlierSearch:
    """Readings far from what all others predict."""

    gross: tuple[FarReading, ...]  #: gross errors that are located, the farthest first
    #: readings that may be noise as well, the farthest first
    doubtful: tuple[FarReading, ...]
    #: numbers of the readings one of which is wrong; empty where none is needed
    unlocated: tuple[int, ...]
    #: numbers of readings that are off the same way, as no single errors are
    alike: tuple[int, ...]
    solution: Fit  #: fit of the readings that are not gross errors
    rest: Fit  #: the same without the doubtful ones
    exhausted: bool  #: whether more readings deviate than can be outliers

    @property
    def readings(self) -> tuple[int, ...]:
        """Numbers of the gross errors, the farthest first."""
        return tuple(one.reading for one in self.gross)

    @property
    def far(self) -> tuple[FarReading, ...]:
        """Gross errors and doubtful readings."""
        return (*self.gross, *self.doubtful)


def find_outliers(
    session: SessionReadings, suspects: Index, *, robust: bool = False
) -> OutlierSearch | None:
    """Outliers of a session; None where it cannot be fitted.

    `suspects` are readings, by number, to leave out of the first fit. With `robust`,
    deviations count in units of their own scatter where it exceeds the stated noise;
    without it they do so only where too many deviate.
    """
    count = 1 + int(session.reading_of_value[-1])
    most = min(max(3, int(MAX_GROSS_SHARE * count)), count // 4)
    if len(suspects) > most:
        suspects = suspects[:0]
    search = far_readings(session, suspects, most, robust=robust)
    if search is None:
        return None
    if search.exhausted:
        solution = fit(session, search.solution.theta)
        if solution is None:
            return None
        return OutlierSearch((), (), (), (), solution, solution, exhausted=True)
    return _judged(session, search, noise_is_a_guess=robust)


# -- gross errors, doubtful and unlocated readings -------------------------------------
def _judged(
    session: SessionReadings, search: FarSearch, *, noise_is_a_guess: bool
) -> OutlierSearch | None:
    """The readings beyond the limit, by the odds of what they are."""
    setups = {s.setup for s in session.series}
    stated = {session.measurement.setups[n].statement.student_dof for n in setups}
    odds = OutlierOdds(search.prediction, stated.pop() if len(stated) == 1 else None)
    fitted = goodness(search.solution)
    start = search.solution.theta
    far = measure(search.prediction, search.readings, search.readings)
    alike = alike_readings(session, far)
    suspects = [k for k in search.readings if k not in alike]
    rest_fits = noise_is_a_guess or fitted.p_high >= SOUND_PROBABILITY
    gross, doubtful, lost = _kinds(odds, suspects, rest_fits=rest_fits)
    if fitted.is_bad(noise_is_a_guess=noise_is_a_guess):
        # what spoils the rest may be what is the matter with them
        doubtful = []
    solution: Fit | None = search.solution
    if len(gross) < len(search.readings):
        solution = fit(session.without(gross), start)
    aside = [*gross, *doubtful]
    rest = fit(session.without(aside), start) if doubtful else solution
    if solution is None or rest is None:
        return None
    unlocated: tuple[int, ...] = ()
    if goodness(rest).is_bad(noise_is_a_guess=noise_is_a_guess) and not alike:
        lost = lost or [odds.likeliest(aside)]
        others = session.without([*aside, *lost])
        without = fit(others, start) if len(others) else None
        # without the right one the others fit; else more than that is wrong
        is_one = without is not None and not goodness(without).is_bad(
            noise_is_a_guess=noise_is_a_guess
        )
        likely = [k for one in lost for k in odds.rivals([*aside, *lost], one)]
        unlocated = tuple(dict.fromkeys(likely)) if is_one else ()
    return OutlierSearch(
        gross=measure(search.prediction, gross, gross),
        doubtful=measure(search.prediction, doubtful, aside),
        unlocated=unlocated,
        alike=alike,
        solution=solution,
        rest=rest,
        exhausted=False,
    )


def _kinds(
    odds: OutlierOdds, suspects: list[int], *, rest_fits: bool
) -> tuple[list[int], list[int], list[int]]:
    """Suspects that are gross errors, perhaps noise, and perhaps another reading."""
    gross = suspects
    doubtful = []
    lost = []
    while gross:
        where = odds.location_odds(gross)
        what = odds.gross_error_odds(gross, rest_fits=rest_fits)
        newly_lost = [k for k in gross if where[k] < np.log(LOCATED_ODDS)]
        noise = [
            k for k in gross if what[k] < np.log(GROSS_ODDS) and k not in newly_lost
        ]
        if not newly_lost and not noise:
            break
        lost += newly_lost
        doubtful += noise
        gross = [k for k in gross if k not in (*newly_lost, *noise)]
    return gross, doubtful, lost
