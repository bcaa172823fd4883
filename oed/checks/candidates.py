"""Which mistakes are worth a fit: the likeliest ones in the linear model."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.checks.mistakes import Given, MistakeTrial, trials
from oed.checks.mistakes.scope import Scope, cuts_are_coarse, part_scopes, several_runs
from oed.checks.mistakes.trial import OnScope, in_scopes
from oed.checks.screening import Score, Screening

#: prior probability that readings have a usual mistake
MISTAKEN = 0.1
#: trials that are fitted first, and most of one kind
FITTED, MOST_OF_KIND = 8, 4
#: parts of a long session near which others are looked at
PARTS = 3
#: runs up to which every set of them is tried where that is quick
MOST_IN_ALL_SETS = 5
#: mistakes of several runs whose set of runs is improved
IMPROVED = 8
#: log evidence, in the linear model, below which a trial is not fitted
HOPELESS = 50.0
#: log evidence by which trials differ that are alike in the linear model
ALIKE = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class MistakeCandidates:
    """Mistakes to fit.

    first   the likeliest in the linear model
    then    the likeliest of each kind: they may act along curves
    """

    first: Sequence[Candidate]
    then: Sequence[Candidate]


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """A mistake to fit.

    trial      the mistake, undone
    log_prior  of it among all mistakes
    scale      of the noise over the stated one, in the linear model
    """

    trial: MistakeTrial
    log_prior: float
    scale: float


def candidates(
    given: Given, screening: Screening, *, thorough: bool, of_noise: bool = False
) -> MistakeCandidates:
    """Mistakes of the readings to fit; see `explain` for `thorough` and `of_noise`."""
    every = list(trials(given, of_noise=of_noise))
    linear = screening.scores(every)
    if cuts_are_coarse(given.session):
        more = list(_near_parts(given, every, linear))
        every, linear = [*every, *more], [*linear, *screening.scores(more)]
    more = list(_of_several_runs(given, every, linear))
    every, linear = [*every, *more], [*linear, *screening.scores(more)]
    improved, scores_of_improved = _improved(given, screening, every, linear)
    every, linear = [*every, *improved], [*linear, *scores_of_improved]
    priors = log_priors(every)
    scores = np.array([one.log_evidence for one in linear]) + priors
    scores[_same_elsewhere(every, linear)] = -np.inf
    as_given = screening.as_given().log_evidence
    first, then = _chosen(every, scores, as_given)
    if not thorough:
        unseen = [
            k for k in then if _is_unseen(every[k], linear[k].log_evidence, as_given)
        ]
        first, then = [k for k in first if scores[k] > as_given], unseen

    def taken(numbers: Sequence[int]) -> list[Candidate]:
        return [Candidate(every[k], float(priors[k]), linear[k].scale) for k in numbers]

    return MistakeCandidates(taken(first), taken(then))


def _same_elsewhere(
    every: Sequence[MistakeTrial], linear: Sequence[Score]
) -> list[int]:
    """Trials that undo no more than the same mistake of another scope does, by number."""
    known: set[tuple[OnScope, float]] = set()
    same = []
    for k, (trial, score) in enumerate(zip(every, linear, strict=True)):
        if trial.on is None:
            continue
        key = (trial.on, round(score.log_evidence, 6))
        if key in known:
            same.append(k)
        known.add(key)
    return same


def _is_unseen(trial: MistakeTrial, log_evidence: float, as_given: float) -> bool:
    """Whether the linear model cannot tell a mistake of the file from the file as given."""
    is_of_file = trial.columns is None and trial.scope.level == "file"
    return is_of_file and log_evidence > as_given - ALIKE


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
    return priors + np.log(MISTAKEN / np.array(shares))


def _chosen(
    every: Sequence[MistakeTrial], scores: Array, as_given: float
) -> tuple[list[int], list[int]]:
    """Numbers of the trials to fit first, and then."""
    of_kind = _by_kind(every, scores)
    ranked = [k for members in of_kind.values() for k in members[:MOST_OF_KIND]]
    ranked.sort(key=lambda k: -scores[k])
    first = [k for k in ranked[:FITTED] if scores[k] > scores[ranked[0]] - HOPELESS]
    likely = [k for ks in of_kind.values() for k in _alike(every, scores, ks)]
    least = as_given - HOPELESS
    return first, [k for k in likely if k not in first and scores[k] > least]


def _by_kind(every: Sequence[MistakeTrial], scores: Array) -> dict[str, list[int]]:
    """Trials by kind, by number, the likeliest first, one of each family."""
    families: set[tuple[str, object]] = set()
    of_kind: dict[str, list[int]] = {}
    for k in np.argsort(-scores, kind="stable"):
        family = (every[k].kind, every[k].family or int(k))
        if np.isfinite(scores[k]) and family not in families:
            families.add(family)
            of_kind.setdefault(every[k].kind, []).append(int(k))
    return of_kind


def _alike(
    every: Sequence[MistakeTrial], scores: Array, members: list[int]
) -> list[int]:
    """The likeliest trial of a kind, and those of the whole file that the linear model can
    hardly tell from it.
    """
    alike = [
        k
        for k in members[1:]
        if every[k].scope.level == "file" and scores[k] > scores[members[0]] - ALIKE
    ]
    return [members[0], *alike[: MOST_OF_KIND - 1]]


def _near_parts(
    given: Given, every: Sequence[MistakeTrial], linear: Sequence[Score]
) -> Iterator[MistakeTrial]:
    """Mistakes of rows that begin or end near those of the likeliest ones."""
    of_rows = [k for k, trial in enumerate(every) if trial.scope.level == "rows"]
    of_rows.sort(key=lambda k: -linear[k].log_evidence)
    near = part_scopes(given.session, [every[k].scope for k in of_rows[:PARTS]])
    for on in {id(every[k].on): every[k].on for k in of_rows}.values():
        if on is not None:
            yield from in_scopes(near, on)


# -- mistakes of several runs ----------------------------------------------------------


def _of_several_runs(
    given: Given, every: Sequence[MistakeTrial], linear: Sequence[Score]
) -> Iterator[MistakeTrial]:
    """Each mistake of runs in the two, three, ... runs where it is likeliest alone."""
    by_form: dict[OnScope, list[int]] = {}
    for k, one in enumerate(every):
        if one.scope.level == "run" and one.on is not None:
            by_form.setdefault(one.on, []).append(k)
    for on, members in by_form.items():
        ranked = sorted(members, key=lambda k: -linear[k].log_evidence)
        runs = [every[k].scope for k in ranked]
        is_quick = every[ranked[0]].table is None
        for some in _sets(runs, every_one=is_quick and len(runs) <= MOST_IN_ALL_SETS):
            trial = _in_runs(given, on, some)
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


def _in_runs(given: Given, on: OnScope, runs: Sequence[Scope]) -> MistakeTrial | None:
    """A mistake of some runs, which are no whole set-up; its prior is shared by all sets
    of runs.
    """
    scope = several_runs(runs)
    if any(np.array_equal(scope.readings, one.readings) for one in given.scopes):
        return None
    trial = on(scope)
    if trial is None:
        return None
    every, some = len(given.runs), len(runs)
    sets = np.log(every) + special.gammaln(every + 1.0)
    sets -= special.gammaln(some + 1.0) + special.gammaln(every - some + 1.0)
    return dataclasses.replace(trial, on=on, log_prior=trial.log_prior - float(sets))


def _improved(
    given: Given,
    screening: Screening,
    every: Sequence[MistakeTrial],
    linear: Sequence[Score],
) -> tuple[list[MistakeTrial], list[Score]]:
    """The likeliest mistakes of several runs with one run more or less, while it helps."""
    several = [k for k, trial in enumerate(every) if trial.scope.level == "runs"]
    several = [k for k in several if every[k].on is not None]
    several.sort(key=lambda k: -linear[k].log_evidence)
    best: dict[OnScope | None, int] = {}
    for k in several:
        best.setdefault(every[k].on, k)
    trials_of: list[MistakeTrial] = []
    scores_of: list[Score] = []
    for k in list(best.values())[:IMPROVED]:
        trial: MistakeTrial = every[k]
        score = linear[k].log_evidence
        for _ in given.runs:
            nearby = list(_with_one_run_changed(given, trial))
            scores = screening.scores(nearby)
            place = max(
                range(len(nearby)), key=lambda i: scores[i].log_evidence, default=-1
            )
            if place < 0 or scores[place].log_evidence <= score:
                break
            trial, score = nearby[place], scores[place].log_evidence
            trials_of.append(trial)
            scores_of.append(scores[place])
    return trials_of, scores_of


def _with_one_run_changed(given: Given, trial: MistakeTrial) -> Iterator[MistakeTrial]:
    inside = [np.isin(run.readings, trial.scope.readings).all() for run in given.runs]
    for k in range(len(inside)):
        runs = [r for i, r in enumerate(given.runs) if inside[i] != (i == k)]
        if trial.on is not None and len(runs) > 1:
            changed = _in_runs(given, trial.on, runs)
            if changed is not None:
                yield changed
