"""Hypotheses that withheld runs refute give their probability to an unknown form.

The evidence of all readings can prefer a name that is wrong, at a size that is: its form
explains what was read and says nonsense between. The readings of a fold F given all
others have the log predictive density

    log p(F | others) = log p(all) - log p(others),

each of the two a log evidence, so that parameters, coefficients and noise level are
learned from the others alone. The sum over the folds, whole runs in turn, compares
hypotheses by prediction (Vehtari and Lampinen 2002, Neural Comput. 14, 2439-2468). Forms
and sizes are chosen with all readings: each choice costs its log prior, so that a form
out of many gains nothing by having been the best of them.

A hypothesis is refuted if withheld runs are 19 times as likely with a remainder of
unknown form in place of some of its effects, or of all. Its probability goes to the one
with the fewest names of those that predict about as well as the best; one with all its
names and an unknown remainder is among them.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Index
from oed.gap.cause.compare import probabilities
from oed.gap.cause.folds import Paths
from oed.gap.cause.hypothesis import Hypothesis, Key
from oed.gap.cause.search import Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem

#: probability from which a hypothesis is tested
TESTED = 0.05
#: log odds of 95 to 5 of a rival over a hypothesis on withheld runs
REFUTED = float(np.log(19.0))


def without_refuted(
    searches: Sequence[Search], hypotheses: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Hypotheses, best first, without those that withheld runs refute."""
    remaining: dict[Key, Hypothesis] = {h.key: h for h in hypotheses}
    others = functools.cache(lambda law: _others_of_folds(searches[law].problem))

    @functools.cache
    def predicted(h: Hypothesis) -> float:
        """Log predictive density of all withheld runs, less the price of the forms."""
        search = searches[h.law]
        return log_withheld(search, h, others(h.law)) + search.log_form_prior(h)

    for h, share in zip(hypotheses, probabilities(hypotheses), strict=True):
        heirs = [r for r in hypotheses if _may_inherit(r, h)]
        rivals = [predicted(r) for r in heirs if len(r.effects) < len(h.effects)]
        if share < TESTED or not rivals or max(rivals) - predicted(h) <= REFUTED:
            continue
        least = max(map(predicted, heirs)) - REFUTED
        near = [r for r in heirs if predicted(r) >= least]
        heir = remaining[min(near, key=lambda r: len(r.effects)).key]
        joint = float(np.logaddexp(heir.score, remaining.pop(h.key).score))
        evidence_of_both = joint - heir.log_prior
        remaining[heir.key] = dataclasses.replace(heir, log_evidence=evidence_of_both)
    return sorted(remaining.values(), key=lambda h: -h.score)


def _may_inherit(other: Hypothesis, h: Hypothesis) -> bool:
    """Whether another has an unknown remainder, and no effects but those of `h`."""
    is_part = set(other.effects) <= set(h.effects)
    return bool(h.effects) and other.unknown and is_part and other.key != h.key


def log_withheld(search: Search, h: Hypothesis, others: Sequence[Index]) -> float:
    """Log predictive density of all folds under a hypothesis, in its best forms.

    others  readings that each fold is predicted from
    """
    problem, law = search.problem, search.law
    effects = h.columns(search.library, search.processes)
    columns = np.hstack([problem.slopes, effects])
    log_all = evidence.log_evidence(problem, law, columns)
    return sum(
        log_all - evidence.log_evidence(problem, law, columns, rows) for rows in others
    )


def _others_of_folds(problem: GapProblem) -> list[Index]:
    """Readings outside each fold: of whole runs, or of stretches of the only one."""
    paths = Paths(problem)
    fold = paths.whole()[0]
    if fold.max() == 0:
        fold = paths.within()[0]
    return [np.flatnonzero(fold != k) for k in range(int(fold.max()) + 1)]
