"""Which mistake explains readings that do not fit: the posterior over all of them.

Every usual mistake is undone, for the file, for each set-up, each run and the first or
last rows (`oed.checks.mistakes`). All are screened in the linear model
(`oed.checks.screening`); the likeliest are fitted. A mistake is named by its posterior
probability against the others and against none: noise of another law, or parameters far
outside their tolerances (`oed.checks.evidence`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.checks.candidates import HOPELESS, MISTAKEN, Candidate, candidates
from oed.checks.evidence import linear_readings, log_evidence
from oed.checks.fit import CANNOT_BE, Fit, fit_amounts, fit_of_any_misfit
from oed.checks.mistakes import Given, MistakeTrial
from oed.checks.outlier_odds import SHARE as SHARE_OF_OUTLIERS
from oed.checks.outliers import MEDIAN, find_outliers
from oed.checks.screening import LOG_SIZES, Screening, log_density_of_any
from oed.checks.session import SessionReadings
from oed.measurement import Measurement

#: readings of which at most the mistakes are compared
MOST_READINGS = 1000
#: log odds against no mistake from which one is named: forms of noise and effects are
#: known so well; share of the best one's probability from which another is named as well
LOG_ODDS, SHARE = 10.0, 0.007
#: misfit over the noise that may remain where a mistake explains readings
EXPLAINED = 3.0
#: misfit that readings count as having which cannot be fitted
MISFIT_WITHOUT_FIT = 100.0
#: kinds that may explain what a specific mistake explains as well, and misfit that is
#: noise: a specific mistake that leaves no more ends the search
GENERAL = ("contradiction", "change", "disorder", "size", "run")
SETTLED = 1.5
#: misfit from which rivals of a mistake are looked at
WITH_RIVALS = 1.5
#: robust standard deviations from which a residual may be an outlier
FAR = 4.5
#: tolerances from nominal beyond which a fit is no machine to be linear about
FAR_PARAMETER = 4.0


@dataclasses.dataclass(frozen=True)
class Explanation:
    """Readings without a mistake, fitted.

    kind           of mistake; empty for the readings as given
    what           the mistake as a sentence, without a full stop
    before         misfit over the stated noise, of the readings as given
    after          the same with the mistake undone; NaN where no readings are left
    probability    among all mistakes and none
    log_posterior  log evidence and log prior
    """

    kind: str
    what: str
    before: float
    after: float
    probability: float = 1.0
    log_posterior: float = 0.0


def explain(
    session: SessionReadings,
    solution: Fit | None,
    measurement: Measurement,
    *,
    thorough: bool = True,
    of_noise: bool = False,
) -> list[Explanation]:
    """Mistakes that explain the readings of a session, likeliest first.

    solution     fit of the readings as given; None where they cannot be fitted
    measurement  the machine with all set-ups of the study
    thorough     whether mistakes are fitted that the linear model does not favour; not
                 needed where a noise law explains the readings
    of_noise     whether the stated noise alone may be mistaken, as where they fit too well
    """
    given = Given(dataclasses.replace(_sample(session), measurement=measurement))
    before = np.inf if solution is None else solution.ratio
    screening = Screening(given)
    nearest = fit_of_any_misfit(given.session, screening.as_given().scale)
    nothing = as_given(nearest)
    if nearest is not None and np.abs(nearest.departure).max() < FAR_PARAMETER:
        screening = _better(
            screening, Screening(dataclasses.replace(given, at=nearest))
        )
        given = screening.given
    fitted: list[Explanation] = []
    for some in candidates(given, screening, thorough=thorough, of_noise=of_noise):
        fitted += [one for c in some if (one := undone(given, c)) is not None]
        if any(_settles(one, nothing) for one in fitted):
            break
    return _explanations(_distinct(fitted), nothing, before)


def _better(one: Screening, other: Screening) -> Screening:
    """The linear model that explains the readings as given better."""
    gain = other.as_given().log_evidence - one.as_given().log_evidence
    return other if gain > 0.0 else one


def _settles(one: Explanation, nothing: Explanation | None) -> bool:
    """Whether a specific mistake leaves the noise alone."""
    odds = np.inf if nothing is None else one.log_posterior - nothing.log_posterior
    is_specific = one.kind not in GENERAL and one.after <= SETTLED
    return bool(is_specific and odds >= HOPELESS)


def _distinct(fitted: Sequence[Explanation]) -> list[Explanation]:
    """Mistakes of different words, likeliest first."""
    best: dict[str, Explanation] = {}
    for one in sorted(fitted, key=lambda one: -one.log_posterior):
        best.setdefault(one.what, one)
    return list(best.values())


def _explanations(
    ranked: Sequence[Explanation], nothing: Explanation | None, before: float
) -> list[Explanation]:
    """Mistakes that are as likely as must be and explain, of those from the likeliest on."""
    if not ranked:
        return []
    alone = np.log1p(-MISTAKEN) + nothing.log_posterior if nothing else -np.inf
    posterior = np.array([one.log_posterior for one in ranked])
    if posterior[0] < alone + LOG_ODDS:
        return []
    weights = special.softmax(np.append(posterior, alone))[:-1]
    explanations = [
        dataclasses.replace(one, before=before, probability=float(weight))
        for one, weight in zip(ranked, weights, strict=True)
        if weight >= SHARE * weights[0]
    ]
    return explanations if _explains(explanations[0]) else []


def _explains(one: Explanation) -> bool:
    """Whether a mistake leaves no misfit, or less than half of it in orders of magnitude.

    What remains then is the noise, or an effect. Where the readings as given have no fit,
    half of nothing known is no measure.
    """
    before = one.before if np.isfinite(one.before) else MISFIT_WITHOUT_FIT
    return bool(np.isnan(one.after) or one.after <= max(EXPLAINED, np.sqrt(before)))


def _sample(session: SessionReadings) -> SessionReadings:
    """Evenly spaced readings of a long session."""
    count = 1 + int(session.reading_of_value[-1])
    if count <= MOST_READINGS:
        return session
    return session.take(np.linspace(0, count - 1, MOST_READINGS).astype(np.intp))


# -- a mistake undone and fitted -------------------------------------------------------


def as_given(nearest: Fit | None) -> Explanation | None:
    """The readings as given, without a prior; None where they cannot be fitted."""
    if nearest is None:
        return None
    try:
        solution, log_density = _with_evidence(nearest)
    except CANNOT_BE:
        return None
    return Explanation("", "", nearest.ratio, solution.ratio, log_posterior=log_density)


def undone(given: Given, candidate: Candidate) -> Explanation | None:
    """The readings without a mistake; None where they cannot be fitted."""
    trial = candidate.trial
    try:
        fits = _fits(trial, candidate.score.scale)
        if fits is None:
            return None
        log_posterior = candidate.log_prior + trial.log_scale
        log_posterior += _log_missing(given, trial)
        amounts = sd = trial.amounts
        if len(amounts):
            amounts, sd = fits[0].amounts, fits[0].sd
            log_posterior += trial.scaling(amounts) - _cost_of_amounts(fits[0])
        else:
            sessions = [one.session for one in fits]
            log_posterior += _log_of_poses_read(given.session, sessions)
        parts = [_with_evidence(one) for one in fits]
    except CANNOT_BE:
        return None
    solutions = [solution for solution, _ in parts]
    if trial.estimated is not None:
        amounts, sd = trial.estimated(solutions[-1])
    return Explanation(
        kind=trial.kind,
        what=trial.words(amounts, sd),
        before=np.nan,
        after=_common_ratio(solutions),
        log_posterior=log_posterior + sum(density for _, density in parts),
    )


def _fits(trial: MistakeTrial, scale: float) -> list[Fit] | None:
    """Fits of the machines apart without a mistake.

    None where one cannot be fitted, or where the amounts may be nothing.
    """
    if not len(trial.amounts):
        sessions = trial.undo(trial.amounts)
        fits = [fit_of_any_misfit(session, scale) for session in sessions]
    else:
        fits = [fit_amounts(trial, scale)]
    known = [one for one in fits if one is not None and one.is_significant]
    return known if len(known) == len(fits) else None


def _common_ratio(solutions: Sequence[Fit]) -> float:
    """Misfit of all fits over the stated noise; NaN where no readings are left."""
    values = [len(one.session) for one in solutions]
    squares = [one.ratio**2 for one in solutions]
    return (
        float(np.sqrt(np.average(squares, weights=values))) if sum(values) else np.nan
    )


def _cost_of_amounts(fitted: Fit) -> float:
    """What the choice of the size of amounts costs; their prior has no scale."""
    size = float(np.mean(fitted.amounts**2))
    gained = np.eye(len(fitted.amounts)) + size * fitted.precision
    return LOG_SIZES + 0.5 * float(np.linalg.slogdet(gained)[1])


def _log_of_poses_read(
    session: SessionReadings, sessions: Sequence[SessionReadings]
) -> float:
    """Log of the densities' ratio where poses are what was read, as with a printer.

    Its readings are all the same, and the noise is in its poses: in a smaller unit of
    these it is as much smaller.
    """
    if np.ptp(session.y) > 0.0:
        return 0.0
    before, after = (
        np.vstack([series.command for s in some for series in s.series]).std(axis=0)
        for some in ([session], sessions)
    )
    varied = (before > 0.0) & (after > 0.0)
    return float(len(session) * np.log(after[varied] / before[varied]).sum())


def _with_evidence(solution: Fit) -> tuple[Fit, float]:
    """The fit without outliers, and the log density of all readings, SI."""
    solution, log_outliers = _without_outliers(solution)
    # rivals need a misfit to explain
    is_misfit = solution.ratio > WITH_RIVALS
    linear = linear_readings(solution)
    density = log_evidence(linear, solution.session, with_rivals=is_misfit)
    return solution, density + log_outliers


def _without_outliers(solution: Fit) -> tuple[Fit, float]:
    """The fit without outliers, where there are few, and the log density of these."""
    session = solution.session
    if not _has_few_far(solution):
        return solution, 0.0
    result = find_outliers(session, np.empty(0, dtype=np.intp))
    if result is None or result.exhausted or not result.far:
        return solution, 0.0
    far = [one.reading for one in result.far]
    values = np.flatnonzero(np.isin(session.reading_of_value, far))
    choices = len(far) * float(np.log(1 + session.reading_of_value[-1]))
    return result.rest, log_density_of_any(Given(session), values) - choices


def _has_few_far(solution: Fit) -> bool:
    """Whether a few residuals are far larger than the others."""
    sizes = np.abs(solution.residual)
    far = sizes > FAR * float(np.median(sizes)) / MEDIAN
    return 0.0 < float(far.mean()) <= SHARE_OF_OUTLIERS


def _log_missing(given: Given, trial: MistakeTrial) -> float:
    """Log density of the values that a trial does not place, SI."""
    if trial.missing is None:
        return 0.0
    if trial.log_missing is not None:
        return trial.log_missing
    return log_density_of_any(given, np.flatnonzero(trial.missing))
