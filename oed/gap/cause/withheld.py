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

A hypothesis is refuted if its effects make the prediction of withheld runs worse than
none does, with 95 % (its closure is below 0), and fewer names with an unknown remainder
predict better, with 95 %. The others share its probability.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.gap.cause import closure
from oed.gap.cause.closure import Paths
from oed.gap.cause.compare import probabilities
from oed.gap.cause.search import Hypothesis, Key, Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.noise import NoiseLaw
from oed.result import ClosureRecord

#: probability among the hypotheses of a gap from which one is asked of withheld runs
MIN_PROBABILITY = 0.002
#: factors on the selected sizes between which training readings choose
SIZE_FACTORS = (1.0, 0.5, 2.0)
#: likeliest forms of each effect between which they choose
MAX_FORMS = 5
#: share of the evidence in the pool, as large as that of prediction
EVIDENCE_SHARE = 0.5
#: probability that a prediction is worse from which a hypothesis is refuted
REFUTING_PROBABILITY = 0.95


def pooled(
    searches: Sequence[Search],
    hypotheses: Sequence[Hypothesis],
    rng: np.random.Generator,
) -> list[Hypothesis]:
    """Hypotheses, best first, those of a gap by evidence and prediction together.

    rng  for the bootstrap of closures
    """
    gaps = [h for h in hypotheses if h.is_gap]
    shares = probabilities(gaps) if gaps else ()
    pairs = zip(gaps, shares, strict=True)
    asked = [h for h, share in pairs if share > MIN_PROBABILITY or not h.effects]
    if len(asked) < 2:
        return list(hypotheses)
    # laws share their readings: folds are laid out once for each set of these
    problems = {id(s.problem): s.problem for s in (searches[h.law] for h in asked)}
    others = {key: _others_of_folds(problem) for key, problem in problems.items()}
    predicted = {}
    for h in asked:
        search = searches[h.law]
        density = log_withheld(search, h, others[id(search.problem)])
        predicted[h.key] = density + search.log_form_prior(h)
    refuted = {h.key for h in asked if _is_refuted(searches[h.law], h, predicted, rng)}
    remaining = [h for h in asked if h.key not in refuted]
    if not remaining:
        return list(hypotheses)
    prediction = np.array([predicted[h.key] + h.log_prior for h in remaining])
    scores = np.array([h.score for h in remaining])
    both = EVIDENCE_SHARE * scores + (1.0 - EVIDENCE_SHARE) * prediction
    both += special.logsumexp([h.score for h in asked]) - special.logsumexp(both)
    results = {h.key: h for h in hypotheses if h.key not in refuted}
    for h, score in zip(remaining, both, strict=True):
        log_evidence = float(score) - h.log_prior
        results[h.key] = dataclasses.replace(h, log_evidence=log_evidence)
    return sorted(results.values(), key=lambda h: -h.score)


def _is_refuted(
    search: Search,
    h: Hypothesis,
    predicted: Mapping[Key, float],
    rng: np.random.Generator,
) -> bool:
    """Whether withheld runs refute a hypothesis.

    predicted  log predictive density of withheld runs by hypothesis
    """
    names = frozenset(h.effects)
    rivals = [
        density
        for (effects, unknown), density in predicted.items()
        if unknown and effects < names
    ]
    if not rivals or max(rivals) - predicted[h.key] < special.logit(
        REFUTING_PROBABILITY
    ):
        return False
    law = search.law_at(search.noise_level(h))
    worse = on_withheld_runs(search, h, law, rng).p_worse
    return worse is not None and worse >= REFUTING_PROBABILITY


def on_withheld_runs(
    search: Search, h: Hypothesis, law: NoiseLaw, rng: np.random.Generator
) -> ClosureRecord:
    """Closure on whole runs, or on stretches of the path of the only one."""
    columns = models(search, h)
    whole = closure.closure(search.problem, law, columns, rng, split="whole")
    if whole.n:
        return whole
    return closure.closure(search.problem, law, columns, rng, split="within")


def models(search: Search, h: Hypothesis) -> list[Array]:
    """Columns (N, k), at their sizes, between which training readings choose.

    The selected forms at other sizes, and with the next best forms of each effect.
    Without effects it is one column that changes nothing.
    """
    forms: dict[tuple[tuple[int, ...], tuple[float, ...]], Hypothesis] = {}
    if h.process is not None and not h.atoms:
        forms[(), ()] = h
    for i, (atom, size) in enumerate(zip(h.atoms, h.sizes, strict=True)):
        others = [h.with_form(i, atom, factor * size) for factor in SIZE_FACTORS]
        others += [other for _, other in search.forms(h, i)[:MAX_FORMS]]
        forms |= {(other.atoms, other.sizes): other for other in others}
    level = search.noise_level(h)
    library, processes = search.library, search.processes
    columns = [other.columns(library, processes, level) for other in forms.values()]
    return columns or [np.zeros((len(search.problem), 1))]


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
