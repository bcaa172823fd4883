"""What withheld runs say of the hypotheses of a gap, pooled with their evidence.

The evidence of all readings can prefer a name at an absurd size: its form explains what
was read and says nonsense between. The readings of a fold F given all others have the log
predictive density

    log p(F | others) = log p(all) - log p(others),

each of the two a log evidence, so that parameters, coefficients and noise level are
learned from the others alone. The sum over the folds, whole runs in turn, compares
hypotheses by prediction (Vehtari and Lampinen 2002, Neural Comput. 14, 2439-2468). Forms
and sizes are chosen with all readings: each choice costs its log prior, so that a form
out of many gains nothing by having been the best of them.

Evidence and prediction are two opinions of the same readings. They are pooled
logarithmically in equal parts (Genest and Zidek 1986, Stat. Sci. 1, 114-135), which
counts no reading twice. How probable a gap is, is left to the evidence.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Index
from oed.gap.cause.compare import probabilities
from oed.gap.cause.folds import Paths
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem

#: probability among the hypotheses of a gap from which one is asked of withheld runs
ASKED = 0.002
#: share of the evidence in the pool, as large as that of prediction
OF_EVIDENCE = 0.5


def pooled(
    searches: Sequence[Search], hypotheses: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Hypotheses, best first, those of a gap by evidence and prediction together."""
    gaps = [h for h in hypotheses if h.is_gap]
    shares = probabilities(gaps) if gaps else ()
    asked = [h for h, share in zip(gaps, shares, strict=True) if share > ASKED]
    if len(asked) < 2:
        return list(hypotheses)
    others = functools.cache(lambda law: _others_of_folds(searches[law].problem))
    predicted = [
        log_withheld(searches[h.law], h, others(h.law))
        + searches[h.law].log_form_prior(h)
        + h.log_prior
        for h in asked
    ]
    scores = np.array([h.score for h in asked])
    both = OF_EVIDENCE * scores + (1.0 - OF_EVIDENCE) * np.array(predicted)
    both += special.logsumexp(scores) - special.logsumexp(both)
    changed = {
        h.key: dataclasses.replace(h, log_evidence=float(score) - h.log_prior)
        for h, score in zip(asked, both, strict=True)
    }
    return sorted((changed.get(h.key, h) for h in hypotheses), key=lambda h: -h.score)


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
