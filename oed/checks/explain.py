"""Which mistake explains readings that do not fit: the posterior over all of them.

Every usual mistake is undone, for the file, for each set-up, each run and the first or
last rows (`oed.checks.mistakes`). All are screened in the linear model
(`oed.checks.screening`); the likeliest are fitted. A mistake is named by its posterior
probability against the others and against none: noise of another law, or parameters far
outside their tolerances (`oed.checks.screening`).
"""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy import special

from oed.base import Array
from oed.checks.fit import CANNOT_BE, Fit, fit_amounts, fit_of_any_misfit
from oed.checks.mistakes import MistakeTrial, Suspect, trials
from oed.checks.mistakes.suspect import Scope, several_runs
from oed.checks.mistakes.trial import OnScope, mistakes_of_scopes
from oed.checks.outlier_odds import MAX_GROSS_SHARE
from oed.checks.outliers import MEDIAN_SIZE, find_outliers
from oed.checks.screening import (
    LOG_SIZE_RANGE,
    Score,
    Screening,
    linear_readings,
    log_evidence,
)
from oed.checks.session import SessionReadings
from oed.measurement import Measurement

# Which mistakes are worth a fit: the likeliest ones in the linear model.

MISTAKE_PROBABILITY = 0.1  #: prior probability that readings have a usual mistake
#: trials of one kind that are fitted, at most: three legs, or six in pairs, have six images,
#: turned by thirds and mirrored
MAX_OF_KIND = 6
#: log evidence, in the linear model, below which a trial is not fitted
MAX_LOG_DEFICIT = 50.0
#: factor between the misfits that the linear model gives two mistakes of a kind which fit
#: alike: by far poses that a mistake moves, its residuals are known to no better
LINEAR_MISFIT_FACTOR = 10.0
#: log evidence by which trials differ that are alike in the linear model
ALIKE_LOG_EVIDENCE = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """A mistake that may be fitted."""

    trial: MistakeTrial  #: the mistake, undone
    score: Score  #: in the linear model
    log_prior: float = 0.0  #: of it among all mistakes

    @property
    def log_posterior(self) -> float:
        """Log posterior in the linear model, up to a constant."""
        return self.score.log_evidence + self.log_prior


def candidates(
    data: Suspect, screening: Screening, *, thorough: bool, of_noise: bool = False
) -> tuple[list[Candidate], list[Candidate]]:
    """Mistakes to fit: the likeliest in the linear model, then those of each kind."""
    every = _scored(screening, trials(data, of_noise=of_noise))
    if data.cut_step > 1:
        every += _scored(screening, _neighbouring_parts(data, every))
    every += _scored(screening, _several_runs_trials(data, every))
    every += _improved(data, screening, every)
    priors = log_priors([one.trial for one in every])
    every = [
        dataclasses.replace(one, log_prior=float(prior))
        for one, prior in zip(every, priors, strict=True)
    ]
    as_given = screening.as_given().log_evidence
    first, then = _chosen(_drop_same(every), as_given, len(data.session))
    if not thorough:
        first = [one for one in first if one.log_posterior > as_given]
        then = [one for one in then if _is_unseen(one, as_given)]
    return first, then


def _scored(screening: Screening, some: Iterable[MistakeTrial]) -> list[Candidate]:
    listed = list(some)
    return list(map(Candidate, listed, screening.scores(listed)))


def _drop_same(every: Sequence[Candidate]) -> list[Candidate]:
    """Mistakes but those that undo no more than the same one of another scope does."""
    seen_keys: set[tuple[OnScope | None, float]] = set()
    different = []
    for one in every:
        key = (one.trial.on, round(one.score.log_evidence, 6))
        if one.trial.on is None or key not in seen_keys:
            different.append(one)
        seen_keys.add(key)
    return different


def _is_unseen(one: Candidate, as_given: float) -> bool:
    """Whether the linear model cannot tell a mistake of the file from the file as given."""
    is_of_file = one.trial.columns is None and one.trial.scope.level == "file"
    return is_of_file and one.score.log_evidence > as_given - ALIKE_LOG_EVIDENCE


def log_priors(every: Sequence[MistakeTrial]) -> Array:
    """Log prior of each trial: kinds alike, then levels of a kind, then its families."""
    kinds = {t.kind for t in every}
    levels = Counter(kind for kind, _ in {(t.kind, t.scope.level) for t in every})
    families = {(t.kind, t.scope.level, t.family or k) for k, t in enumerate(every)}
    counts = Counter((kind, level) for kind, level, _ in families)
    shares = [
        len(kinds) * levels[t.kind] * counts[t.kind, t.scope.level] for t in every
    ]
    priors = np.array([t.log_prior for t in every])
    return priors + np.log(MISTAKE_PROBABILITY / np.array(shares))


def _chosen(
    every: Sequence[Candidate], as_given: float, count: int
) -> tuple[list[Candidate], list[Candidate]]:
    """Mistakes of `count` values to fit first, and then."""
    of_kind = _rank_by_kind(every)
    ranked = [one for members in of_kind.values() for one in members[:MAX_OF_KIND]]
    ranked = _likeliest_first(ranked)
    first = [one for one in ranked[:8] if _may_be_as_good(one, ranked[0], count)]
    likely = [one for members in of_kind.values() for one in _alike(members)]
    least = as_given - MAX_LOG_DEFICIT
    return first, [c for c in likely if c not in first and c.log_posterior > least]


def _may_be_as_good(one: Candidate, best: Candidate, count: int) -> bool:
    """Whether a mistake may explain `count` values as well as the likeliest one does."""
    margin = MAX_LOG_DEFICIT
    if one.trial.kind == best.trial.kind and one.trial.scope.level == "file":
        margin = max(margin, count * np.log(LINEAR_MISFIT_FACTOR))
    return bool(one.log_posterior > best.log_posterior - margin)


def _likeliest_first(some: Sequence[Candidate]) -> list[Candidate]:
    return sorted(some, key=lambda one: -one.log_posterior)


def _rank_by_kind(every: Sequence[Candidate]) -> dict[str, list[Candidate]]:
    """Mistakes by kind, the likeliest first, one of each family."""
    families: set[tuple[str, object]] = set()
    of_kind: dict[str, list[Candidate]] = {}
    for one in _likeliest_first([c for c in every if np.isfinite(c.log_posterior)]):
        family = (one.trial.kind, one.trial.family or id(one))
        if family not in families:
            families.add(family)
            of_kind.setdefault(one.trial.kind, []).append(one)
    return of_kind


def _alike(members: Sequence[Candidate]) -> list[Candidate]:
    """The likeliest mistake of a kind, and those of the whole file that the linear model
    can hardly tell from it.
    """
    alike = [
        one
        for one in members[1:]
        if one.trial.scope.level == "file"
        and one.log_posterior > members[0].log_posterior - ALIKE_LOG_EVIDENCE
    ]
    return [members[0], *alike[: MAX_OF_KIND - 1]]


def _neighbouring_parts(
    data: Suspect, every: Sequence[Candidate]
) -> Iterator[MistakeTrial]:
    """Mistakes of rows that begin or end near those of the likeliest ones."""
    of_rows = [one for one in every if one.trial.scope.level == "rows"]
    likeliest = [one.trial.scope for one in _likeliest_first(of_rows)[:3]]
    near = data.parts_near(likeliest)
    for on in dict.fromkeys(one.trial.on for one in of_rows):
        if on is not None:
            yield from mistakes_of_scopes(near, on)


# -- mistakes of several runs ----------------------------------------------------------
def _several_runs_trials(
    data: Suspect, every: Sequence[Candidate]
) -> Iterator[MistakeTrial]:
    """Each mistake of runs in the two, three, ... runs where it is likeliest alone."""
    by_form: dict[OnScope, list[MistakeTrial]] = {}
    for one in _likeliest_first(every):
        if one.trial.scope.level == "run" and one.trial.on is not None:
            by_form.setdefault(one.trial.on, []).append(one.trial)
    for on, members in by_form.items():
        runs = [trial.scope for trial in members]
        is_quick = members[0].table is None
        for some in _sets(runs, every_one=is_quick and len(runs) <= 5):
            trial = _trial_in_runs(data, on, some)
            if trial is not None:
                yield trial


def _sets(runs: Sequence[Scope], *, every_one: bool) -> Iterator[Sequence[Scope]]:
    """All sets of two runs and more, or the first ones, and every other one."""
    if every_one:
        for count in range(2, len(runs)):
            yield from itertools.combinations(runs, count)
        return
    in_order = sorted(runs, key=lambda run: int(run.readings[0]))
    yield from (runs[:count] for count in range(2, len(runs)))
    yield from (part for part in (in_order[::2], in_order[1::2]) if len(part) > 1)


def _trial_in_runs(
    data: Suspect, on: OnScope, runs: Sequence[Scope]
) -> MistakeTrial | None:
    """A mistake of some runs, which are no whole set-up; its prior is shared by all sets
    of runs.
    """
    scope = several_runs(runs)
    if any(np.array_equal(scope.readings, one.readings) for one in data.scopes):
        return None
    trial = on(scope)
    if trial is None:
        return None
    every = len(data.runs)
    log_sets = float(np.log(every * special.binom(every, len(runs))))
    return dataclasses.replace(trial, on=on, log_prior=trial.log_prior - log_sets)


def _improved(
    data: Suspect, screening: Screening, every: Sequence[Candidate]
) -> list[Candidate]:
    """The likeliest mistakes of several runs with one run more or less, while it helps."""
    best: dict[OnScope, Candidate] = {}
    for one in _likeliest_first(every):
        if one.trial.scope.level == "runs" and one.trial.on is not None:
            best.setdefault(one.trial.on, one)
    improved: list[Candidate] = []
    for one in list(best.values())[:8]:
        last = one
        for _ in data.runs:
            nearby = _scored(screening, _exchange_one_run(data, last.trial))
            likeliest = _likeliest_first([last, *nearby])[0]
            if likeliest is last:
                break
            last = likeliest
            improved.append(last)
    return improved


def _exchange_one_run(data: Suspect, trial: MistakeTrial) -> Iterator[MistakeTrial]:
    inside = [np.isin(run.readings, trial.scope.readings).all() for run in data.runs]
    for k in range(len(inside)):
        runs = [r for i, r in enumerate(data.runs) if inside[i] != (i == k)]
        if trial.on is not None and len(runs) > 1:
            changed = _trial_in_runs(data, trial.on, runs)
            if changed is not None:
                yield changed


MAX_COMPARED = 1000  #: readings of which at most the mistakes are compared
#: log odds against no mistake from which one is named: forms of noise and effects are
#: known so well
MIN_LOG_ODDS = 10.0
#: share of the best one's probability from which another is named as well
NAMED_SHARE = 0.007
#: misfit over the noise that may remain where a mistake explains readings
MAX_EXPLAINED_RATIO = 3.0
#: share of the mean square beyond the noise that undoing it must take away: a mistake
#: that explains less leaves most of the misfit to another cause
MIN_EXPLAINED_SHARE = 0.5
#: the largest probability that is stated: no evidence is certain
MAX_PROBABILITY = 0.9999
MIN_MISFIT = 1e-9  #: misfit over the noise that is none
#: standard deviations of a misfit by which undoing a mistake must bring it nearer to the noise
MIN_IMPROVEMENT = 2.0
#: kinds that may explain what a specific mistake explains as well, and misfit that is
#: noise: a specific mistake that leaves no more ends the search
GENERAL_KINDS = ("contradiction", "change", "disorder", "size", "run")
SETTLED_RATIO = 1.5
RIVAL_RATIO = 1.5  #: misfit from which rivals of a mistake are looked at
#: tolerances from nominal beyond which a fit is no machine to be linear about
MAX_PARAMETER_DEPARTURE = 4.0


@dataclasses.dataclass(frozen=True)
class Explanation:
    """Readings without a mistake, fitted."""

    kind: str  #: of mistake; empty for the readings as given
    what: str  #: the mistake as a sentence, without a full stop
    before: float  #: misfit over the stated noise, of the readings as given
    after: float  #: the same with the mistake undone; NaN where no readings are left
    probability: float = 1.0  #: among all mistakes and none
    log_posterior: float = 0.0  #: log evidence and log prior


def explain(
    session: SessionReadings,
    solution: Fit | None,
    measurement: Measurement,
    *,
    thorough: bool = True,
    of_noise: bool = False,
) -> list[Explanation]:
    """Mistakes that explain the readings of a session, likeliest first.

    solution  fit of the readings as given; None where they cannot be fitted
    thorough  whether mistakes are fitted that the linear model does not favour
    of_noise  whether the stated noise alone may be mistaken, as where they fit too well
    """
    data = Suspect(dataclasses.replace(_sample(session), measurement=measurement))
    before = np.inf if solution is None else solution.ratio
    screening = Screening(data)
    nearest = fit_of_any_misfit(data.session, screening.as_given().scale)
    nothing = as_given(nearest)
    if nothing is not None and solution is not None and solution.session.law:
        before = nothing.after  # misfits are by the stated noise
    if (
        nearest is not None
        and np.abs(nearest.departure).max() < MAX_PARAMETER_DEPARTURE
    ):
        near = Screening(dataclasses.replace(data, at=nearest))
        # the linear model that explains the readings as given better
        if near.as_given().log_evidence > screening.as_given().log_evidence:
            screening, data = near, near.data
    fitted: list[Explanation] = []
    for some in candidates(data, screening, thorough=thorough, of_noise=of_noise):
        fitted += [one for c in some if (one := undone(data, c)) is not None]
        if any(_settles(one, nothing) for one in fitted):
            break
    return _explanations(_distinct(fitted), nothing, before, len(data.session))


def _settles(one: Explanation, nothing: Explanation | None) -> bool:
    """Whether a specific mistake leaves the noise alone."""
    odds = np.inf if nothing is None else one.log_posterior - nothing.log_posterior
    is_specific = one.kind not in GENERAL_KINDS and one.after <= SETTLED_RATIO
    return bool(is_specific and odds >= MAX_LOG_DEFICIT)


def _distinct(fitted: Sequence[Explanation]) -> list[Explanation]:
    """Mistakes of different words, likeliest first."""
    best: dict[str, Explanation] = {}
    for one in sorted(fitted, key=lambda one: -one.log_posterior):
        best.setdefault(one.what, one)
    return list(best.values())


def _explanations(
    ranked: Sequence[Explanation],
    nothing: Explanation | None,
    before: float,
    count: int,
) -> list[Explanation]:
    """Those of the ranked mistakes that explain `count` values of a misfit `before`."""
    if not ranked:
        return []
    alone = (
        np.log1p(-MISTAKE_PROBABILITY) + nothing.log_posterior if nothing else -np.inf
    )
    posterior = np.array([one.log_posterior for one in ranked])
    if posterior[0] < alone + MIN_LOG_ODDS:
        return []
    weights = special.softmax(np.append(posterior, alone))[:-1]
    explanations = [
        dataclasses.replace(
            one, before=before, probability=min(float(weight), MAX_PROBABILITY)
        )
        for one, weight in zip(ranked, weights, strict=True)
        if weight >= NAMED_SHARE * weights[0]
    ]
    if not (_explains(explanations[0]) and _improves(explanations[0], count)):
        return []
    return [one for one in explanations if _improves(one, count)]


def _improves(one: Explanation, count: int) -> bool:
    """Whether undoing a mistake lowers log misfit, of sd 1 / sqrt(2 count), surely."""
    if not np.isfinite([one.before, one.after]).all():
        return True
    before, after = np.abs(np.log(np.maximum([one.before, one.after], MIN_MISFIT)))
    return bool(before - after > MIN_IMPROVEMENT / np.sqrt(2.0 * count))


def _explains(one: Explanation) -> bool:
    """Whether a mistake leaves little misfit, and less than half of what was there."""
    before = one.before if np.isfinite(one.before) else 100.0
    if np.isnan(one.after):
        return True
    beyond_noise = max(before**2 - 1.0, 0.0)
    is_most = before**2 - one.after**2 >= MIN_EXPLAINED_SHARE * beyond_noise
    return bool(is_most and one.after <= max(MAX_EXPLAINED_RATIO, np.sqrt(before)))


def _sample(session: SessionReadings) -> SessionReadings:
    """Evenly spaced readings of a long session."""
    count = 1 + int(session.reading_of_value[-1])
    if count <= MAX_COMPARED:
        return session
    return session.take(np.linspace(0, count - 1, MAX_COMPARED).astype(np.intp))


# -- a mistake undone and fitted -------------------------------------------------------
def as_given(nearest: Fit | None) -> Explanation | None:
    """The readings as given, without a prior; None where they cannot be fitted."""
    if nearest is None:
        return None
    try:
        solution, log_density = _evidence(nearest)
    except CANNOT_BE:
        return None
    return Explanation("", "", nearest.ratio, solution.ratio, log_posterior=log_density)


def undone(data: Suspect, candidate: Candidate) -> Explanation | None:
    """The readings without a mistake; None where they cannot be fitted."""
    trial = candidate.trial
    try:
        fits = _fits(trial, candidate.score.scale)
        if fits is None:
            return None
        log_posterior = candidate.log_prior + trial.log_scale
        log_posterior += trial.log_density_missing
        amounts = sd = trial.amounts
        if len(amounts):
            amounts, sd = fits[0].amounts, fits[0].sd
            log_posterior += trial.scaling(amounts) - _cost_of_amounts(fits[0])
        else:
            sessions = [one.session for one in fits]
            log_posterior += _log_of_poses_read(data.session, sessions)
        parts = [_evidence(one) for one in fits]
    except CANNOT_BE:
        return None
    solutions = [solution for solution, _ in parts]
    if trial.estimated is not None:
        amounts, sd = trial.estimated(solutions[-1])
    return Explanation(
        kind=trial.kind,
        what=trial.text(amounts, sd),
        before=np.nan,
        after=_common_ratio(solutions),
        log_posterior=log_posterior + sum(density for _, density in parts),
    )


def _fits(trial: MistakeTrial, scale: float) -> list[Fit] | None:
    """Fits of the machines apart; None without one, or where amounts may be nothing."""
    if not len(trial.amounts):
        sessions = trial.undo(trial.amounts)
        fits = [fit_of_any_misfit(session, scale) for session in sessions]
    else:
        fits = [fit_amounts(trial, scale)]
    usable = [one for one in fits if one is not None and one.is_significant]
    return usable if len(usable) == len(fits) else None


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
    return LOG_SIZE_RANGE + 0.5 * float(np.linalg.slogdet(gained)[1])


def _log_of_poses_read(
    session: SessionReadings, sessions: Sequence[SessionReadings]
) -> float:
    """Log of the densities' ratio where poses are what was read, as with a printer:
    their spread is the unit of the noise, and readings are all the same.
    """
    total = 0.0
    # machines apart have fewer series, of poses that do not change; none: no reading stays
    others = sessions[0].series if sessions else ()
    pairs = zip(session.series, others, session.spans, strict=False)
    for before, after, span in pairs:
        if len(before) != len(after) or np.ptp(session.y[span]) > 0.0:
            continue
        changed = before.command != after.command
        for k in np.flatnonzero(changed.any(axis=0)):
            rows = changed[:, k] | (before.command[:, k] == 0.0)  # 0 in any unit
            spreads = before.command[rows, k].std(), after.command[rows, k].std()
            if min(spreads) > 0.0:
                total += float(rows.sum() * np.log(spreads[1] / spreads[0]))
    return total


def _evidence(solution: Fit) -> tuple[Fit, float]:
    """The fit without outliers, and the log density of all readings, SI."""
    solution, log_outliers = _drop_outliers(solution)
    # rivals need a misfit to explain
    is_misfit = solution.ratio > RIVAL_RATIO
    linear = linear_readings(solution)
    density = log_evidence(linear, solution.session, with_rivals=is_misfit)
    return solution, density + log_outliers


def _drop_outliers(solution: Fit) -> tuple[Fit, float]:
    """The fit without outliers, where there are few, and the log density of these."""
    session, sizes = solution.session, np.abs(solution.residual)
    is_far = sizes > 4.5 * float(np.median(sizes)) / MEDIAN_SIZE
    if not 0.0 < float(is_far.mean()) <= MAX_GROSS_SHARE:
        return solution, 0.0
    result = find_outliers(session, np.empty(0, dtype=np.intp))
    if result is None or result.exhausted or not result.far:
        return solution, 0.0
    far = [one.reading for one in result.far]
    values = np.isin(session.reading_of_value, far)
    choices = len(far) * float(np.log(1 + session.reading_of_value[-1]))
    return result.rest, Suspect(session).log_density_of_any(values) - choices
