"""Which mistakes are worth a fit: the likeliest ones in the linear model."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy import special

from oed.base import Array
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
class Candidate:
    """A mistake that may be fitted.

    trial      the mistake, undone
    score      in the linear model
    log_prior  of it among all mistakes
    """

    trial: MistakeTrial
    score: Score
    log_prior: float = 0.0

    @property
    def log_posterior(self) -> float:
        """Log posterior in the linear model, up to a constant."""
        return self.score.log_evidence + self.log_prior


def candidates(
    given: Given, screening: Screening, *, thorough: bool, of_noise: bool = False
) -> tuple[list[Candidate], list[Candidate]]:
    """Mistakes of the readings to fit; see `explain` for `thorough` and `of_noise`.

    First the likeliest in the linear model, then the likeliest of each kind: they may act
    along curves.
    """
    every = _scored(screening, trials(given, of_noise=of_noise))
    if cuts_are_coarse(given.session):
        every += _scored(screening, _near_parts(given, every))
    every += _scored(screening, _of_several_runs(given, every))
    every += _improved(given, screening, every)
    priors = log_priors([one.trial for one in every])
    every = [
        dataclasses.replace(one, log_prior=float(prior))
        for one, prior in zip(every, priors, strict=True)
    ]
    as_given = screening.as_given().log_evidence
    first, then = _chosen(_without_same(every), as_given)
    if not thorough:
        first = [one for one in first if one.log_posterior > as_given]
        then = [one for one in then if _is_unseen(one, as_given)]
    return first, then


def _scored(screening: Screening, some: Iterable[MistakeTrial]) -> list[Candidate]:
    listed = list(some)
    return list(map(Candidate, listed, screening.scores(listed)))


def _without_same(every: Sequence[Candidate]) -> list[Candidate]:
    """Mistakes but those that undo no more than the same one of another scope does."""
    known: set[tuple[OnScope | None, float]] = set()
    different = []
    for one in every:
        key = (one.trial.on, round(one.score.log_evidence, 6))
        if one.trial.on is None or key not in known:
            different.append(one)
        known.add(key)
    return different


def _is_unseen(one: Candidate, as_given: float) -> bool:
    """Whether the linear model cannot tell a mistake of the file from the file as given."""
    is_of_file = one.trial.columns is None and one.trial.scope.level == "file"
    return is_of_file and one.score.log_evidence > as_given - ALIKE


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
    every: Sequence[Candidate], as_given: float
) -> tuple[list[Candidate], list[Candidate]]:
    """Mistakes to fit first, and then."""
    of_kind = _by_kind(every)
    ranked = [one for members in of_kind.values() for one in members[:MOST_OF_KIND]]
    ranked = _likeliest_first(ranked)
    first = [
        one
        for one in ranked[:FITTED]
        if one.log_posterior > ranked[0].log_posterior - HOPELESS
    ]
    likely = [one for members in of_kind.values() for one in _alike(members)]
    least = as_given - HOPELESS
    return first, [c for c in likely if c not in first and c.log_posterior > least]


def _likeliest_first(some: Sequence[Candidate]) -> list[Candidate]:
    return sorted(some, key=lambda one: -one.log_posterior)


def _by_kind(every: Sequence[Candidate]) -> dict[str, list[Candidate]]:
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
        and one.log_posterior > members[0].log_posterior - ALIKE
    ]
    return [members[0], *alike[: MOST_OF_KIND - 1]]


def _near_parts(given: Given, every: Sequence[Candidate]) -> Iterator[MistakeTrial]:
    """Mistakes of rows that begin or end near those of the likeliest ones."""
    of_rows = [one for one in every if one.trial.scope.level == "rows"]
    likeliest = [one.trial.scope for one in _likeliest_first(of_rows)[:PARTS]]
    near = part_scopes(given.session, likeliest)
    for on in dict.fromkeys(one.trial.on for one in of_rows):
        if on is not None:
            yield from in_scopes(near, on)


# -- mistakes of several runs ----------------------------------------------------------


def _of_several_runs(
    given: Given, every: Sequence[Candidate]
) -> Iterator[MistakeTrial]:
    """Each mistake of runs in the two, three, ... runs where it is likeliest alone."""
    by_form: dict[OnScope, list[MistakeTrial]] = {}
    for one in _likeliest_first(every):
        if one.trial.scope.level == "run" and one.trial.on is not None:
            by_form.setdefault(one.trial.on, []).append(one.trial)
    for on, members in by_form.items():
        runs = [trial.scope for trial in members]
        is_quick = members[0].table is None
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
    given: Given, screening: Screening, every: Sequence[Candidate]
) -> list[Candidate]:
    """The likeliest mistakes of several runs with one run more or less, while it helps."""
    best: dict[OnScope, Candidate] = {}
    for one in _likeliest_first(every):
        if one.trial.scope.level == "runs" and one.trial.on is not None:
            best.setdefault(one.trial.on, one)
    improved: list[Candidate] = []
    for one in list(best.values())[:IMPROVED]:
        last = one
        for _ in given.runs:
            nearby = _scored(screening, _with_one_run_changed(given, last.trial))
            likeliest = _likeliest_first([last, *nearby])[0]
            if likeliest is last:
                break
            last = likeliest
            improved.append(last)
    return improved


def _with_one_run_changed(given: Given, trial: MistakeTrial) -> Iterator[MistakeTrial]:
    inside = [np.isin(run.readings, trial.scope.readings).all() for run in given.runs]
    for k in range(len(inside)):
        runs = [r for i, r in enumerate(given.runs) if inside[i] != (i == k)]
        if trial.on is not None and len(runs) > 1:
            changed = _in_runs(given, trial.on, runs)
            if changed is not None:
                yield changed
