"""Outliers: readings that all others together contradict, named row by row.

A reading beyond the limit (`outlier_search`) is set aside only where it is surely a gross
error and no noise, and surely this reading and no other (`outlier_odds`). One that may be
noise of heavy tails is doubtful and stays in the fit. Where one reading of several must
be wrong, they are unlocated: all stay in the fit, which is bad. Readings that are off
alike (`far_reading`) are no single errors, and show an effect to a diagnosis.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Index
from oed.checks.far_reading import FarReading, alike_readings, measure
from oed.checks.fit import Fit, fit
from oed.checks.goodness import goodness
from oed.checks.outlier_odds import LOCATED, PROVEN, SHARE, OutlierOdds
from oed.checks.outlier_search import FarSearch, far_readings
from oed.checks.session import SessionReadings

#: readings of a small session that can be outliers
LEAST = 3
#: probability of larger residuals from which on the other readings fit the stated noise
SOUND = 0.01


@dataclasses.dataclass(frozen=True)
class OutlierSearch:
    """Readings far from what all others predict.

    gross      gross errors that are located, the farthest first
    doubtful   readings that may be noise as well, the farthest first
    unlocated  numbers of the readings one of which is wrong; empty where none is needed
    alike      numbers of readings that are off the same way, as no single errors are
    solution   fit of the readings that are not gross errors
    rest       the same without the doubtful ones
    exhausted  whether more readings deviate than can be outliers
    """

    gross: tuple[FarReading, ...]
    doubtful: tuple[FarReading, ...]
    unlocated: tuple[int, ...]
    alike: tuple[int, ...]
    solution: Fit
    rest: Fit
    exhausted: bool

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
    most = min(max(LEAST, int(SHARE * count)), count // 4)
    if len(suspects) > most:
        suspects = suspects[:0]
    search = far_readings(session, suspects, most, robust=robust)
    if search is None:
        return None
    if search.exhausted:
        return _exhausted(session, search)
    return _judged(session, search, noise_is_a_guess=robust)


def _exhausted(session: SessionReadings, search: FarSearch) -> OutlierSearch | None:
    """More readings deviate than can be outliers: none is one."""
    solution = fit(session, search.solution.theta)
    if solution is None:
        return None
    return OutlierSearch((), (), (), (), solution, solution, exhausted=True)


# -- gross errors, doubtful and unlocated readings -------------------------------------


def _judged(
    session: SessionReadings, search: FarSearch, *, noise_is_a_guess: bool
) -> OutlierSearch | None:
    """The readings beyond the limit, by the odds of what they are."""
    setups = {s.setup for s in session.series}
    stated = {session.measurement.setups[n].statement.student_dof for n in setups}
    odds = OutlierOdds(search.prediction, stated.pop() if len(stated) == 1 else None)
    fitted, start = goodness(search.solution), search.solution.theta
    far = measure(search.prediction, search.readings, search.readings)
    alike = alike_readings(session, far)
    suspects = [k for k in search.readings if k not in alike]
    rest_fits = noise_is_a_guess or fitted.p_high >= SOUND
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
    """Suspects that are gross errors, perhaps noise, and perhaps another reading.

    Readings that are no gross errors return to the others, whose odds they change.
    """
    gross, doubtful, lost = suspects, [], []
    while gross:
        where = odds.of_location(gross)
        what = odds.of_gross_error(gross, rest_fits=rest_fits)
        newly_lost = [k for k in gross if where[k] < np.log(LOCATED)]
        noise = [k for k in gross if what[k] < np.log(PROVEN) and k not in newly_lost]
        if not newly_lost and not noise:
            break
        lost += newly_lost
        doubtful += noise
        gross = [k for k in gross if k not in (*newly_lost, *noise)]
    return gross, doubtful, lost
