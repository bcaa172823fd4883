"""Which mistakes are worth a fit: the likeliest ones in the linear model."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.checks.mistakes import Given, MistakeTrial, trials, trials_near
from oed.checks.mistakes.scope import Scope, cuts_are_coarse
from oed.checks.screening import Score, Screening

#: prior probability that readings have a usual mistake
MISTAKEN = 0.1
#: trials that are fitted first, and most of one kind
FITTED, MOST_OF_KIND = 8, 4
#: parts of a long session near which others are looked at
PARTS = 3
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
    given: Given, screening: Screening, *, thorough: bool
) -> MistakeCandidates:
    """Mistakes of the readings to fit; see `explain` for `thorough`."""
    every = list(trials(given))
    linear = screening.scores(every)
    if cuts_are_coarse(given.session):
        more = list(trials_near(given, _likeliest_parts(every, linear)))
        every, linear = [*every, *more], [*linear, *screening.scores(more)]
    priors = log_priors(every)
    scores = np.array([one.log_evidence for one in linear]) + priors
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


def _likeliest_parts(
    every: Sequence[MistakeTrial], linear: Sequence[Score]
) -> list[Scope]:
    """Parts of set-ups and runs of the likeliest mistakes of rows."""
    of_rows = [k for k, trial in enumerate(every) if trial.scope.level == "rows"]
    of_rows.sort(key=lambda k: -linear[k].log_evidence)
    return [every[k].scope for k in of_rows[:PARTS]]
