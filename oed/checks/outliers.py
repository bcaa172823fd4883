"""Outliers: readings that all others together contradict, named row by row.

A reading beyond the limit (`outlier_search`) is set aside only where it is surely a gross
error and no noise, and surely this reading and no other (`outlier_odds`). One that may be
noise of heavy tails is doubtful and stays in the fit. Where one reading of several must
be wrong, they are unlocated: all stay in the fit, which is bad. Readings that are off
alike (`far_reading`) are no single errors, and show an effect to a diagnosis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Index
from oed.checks import outlier_odds
from oed.checks.far_reading import FarReading, alike_readings, measure
from oed.checks.fit import Fit, fit
from oed.checks.goodness import goodness
from oed.checks.outlier_odds import LOCATED, PROVEN, SHARE, Suspects
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
    kinds = _kinds(session, search, noise_is_a_guess=noise_is_a_guess)
    start = search.solution.theta
    solution = search.solution
    if len(kinds.gross) < len(search.readings):
        refit = fit(session.without(kinds.gross), start)
        if refit is None:
            return None
        solution = refit
    aside = [*kinds.gross, *kinds.doubtful]
    rest = fit(session.without(aside), start) if kinds.doubtful else solution
    if rest is None:
        return None
    unlocated: tuple[int, ...] = ()
    is_bad = goodness(rest).is_bad(noise_is_a_guess=noise_is_a_guess)
    if is_bad and not kinds.alike:
        unlocated = _unlocated(
            session, search, kinds, noise_is_a_guess=noise_is_a_guess
        )
    return OutlierSearch(
        gross=measure(session, search.prediction, kinds.gross, kinds.gross),
        doubtful=measure(session, search.prediction, kinds.doubtful, aside),
        unlocated=unlocated,
        alike=kinds.alike,
        solution=solution,
        rest=rest,
        exhausted=False,
    )


@dataclasses.dataclass(frozen=True)
class _Kinds:
    """Readings beyond the limit, by what they are.

    gross     gross errors
    doubtful  perhaps noise
    lost      perhaps another reading
    alike     no single errors: the same happens to several
    """

    gross: list[int]
    doubtful: list[int]
    lost: list[int]
    alike: tuple[int, ...]


def _kinds(
    session: SessionReadings, search: FarSearch, *, noise_is_a_guess: bool
) -> _Kinds:
    """The kind of each reading beyond the limit.

    Readings that are no gross errors return to the others, whose odds they change.
    """
    fitted = goodness(search.solution)
    rest_fits = noise_is_a_guess or fitted.p_high >= SOUND
    alike = alike_readings(
        session, measure(session, search.prediction, search.readings, search.readings)
    )
    gross = [k for k in search.readings if k not in alike]
    doubtful: list[int] = []
    lost: list[int] = []
    while gross:
        suspects = _suspects(session, search, gross)
        where = outlier_odds.location_odds(suspects)
        what = outlier_odds.gross_odds(suspects, rest_fits=rest_fits)
        newly_lost = [k for k in gross if where[k] < np.log(LOCATED)]
        noise = [k for k in gross if what[k] < np.log(PROVEN) and k not in newly_lost]
        if not newly_lost and not noise:
            break
        lost += newly_lost
        doubtful += noise
        gross = [k for k in gross if k not in (*newly_lost, *noise)]
    if fitted.is_bad(noise_is_a_guess=noise_is_a_guess):
        # what spoils the rest may be what is the matter with them
        doubtful = []
    return _Kinds(gross, doubtful, lost, alike)


def _unlocated(
    session: SessionReadings,
    search: FarSearch,
    kinds: _Kinds,
    *,
    noise_is_a_guess: bool,
) -> tuple[int, ...]:
    """Readings one of which is wrong: without the right one the others fit.

    Empty where more than that is wrong.
    """
    aside = [*kinds.gross, *kinds.doubtful]
    lost = kinds.lost
    if not lost:
        suspects = _suspects(session, search, aside)
        lost = [outlier_odds.likeliest(suspects)]
    others = session.without([*aside, *lost])
    without = fit(others, search.solution.theta) if len(others.y) else None
    if without is None:
        return ()
    if goodness(without).is_bad(noise_is_a_guess=noise_is_a_guess):
        return ()
    suspects = _suspects(session, search, [*aside, *lost])
    likely = [k for one in lost for k in outlier_odds.rivals(suspects, one)]
    return tuple(dict.fromkeys(likely))


def _suspects(
    session: SessionReadings, search: FarSearch, members: Sequence[int]
) -> Suspects:
    setups = {s.setup for s in session.series}
    stated = {session.measurement.setups[n].statement.student_dof for n in setups}
    return Suspects(
        prediction=search.prediction,
        reading=session.reading_of_value,
        sigma=search.prediction.noise.sigma,
        members=tuple(members),
        student=stated.pop() if len(stated) == 1 else None,
    )
