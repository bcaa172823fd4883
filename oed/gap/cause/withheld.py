"""What withheld runs say of the hypotheses of a gap, pooled with their evidence.

The evidence of all readings can prefer a name at an absurd size: its form explains what
was read and says nonsense between. The readings of a fold F given all others have the
log predictive density log p(F | others) = log p(all) - log p(others), each of the two a
log evidence: parameters, coefficients and noise level are learned from the others alone.
Its sum over the folds, whole runs in turn, compares hypotheses by prediction (Vehtari and
Lampinen 2002, Neural Comput. 14, 2439-2468). Forms and sizes are chosen with all
readings, so each choice costs its log prior. Evidence and prediction are two opinions of
the same readings, pooled logarithmically in equal parts (Genest and Zidek 1986, Stat.
Sci. 1, 114-135). How probable a gap is, is left to the evidence.

All forms are approximate, and their evidence too sure: a power t <= 1 of it counts, by how
well other runs predict a withheld one (docs/theory/diagnosis.md).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.gap.cause.closure import Paths
from oed.gap.cause.compare import MIN_ASKED, probabilities
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem

#: factors on the selected sizes between which training readings choose
SIZE_FACTORS = (1.0, 0.5, 2.0)
MAX_FORMS = 5  #: likeliest forms of each effect between which they choose
#: powers of the evidence, equally likely before withheld runs
POWERS = np.linspace(0.05, 1.0, 20)


def pooled(
    searches: Sequence[Search], hypotheses: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """Hypotheses, best first, those of a gap by evidence and prediction together."""
    gaps = [h for h in hypotheses if h.is_gap]
    shares = probabilities(gaps) if gaps else ()
    pairs = zip(gaps, shares, strict=True)
    asked = [h for h, share in pairs if share > MIN_ASKED or not h.effects]
    if len(asked) < 2:
        return list(hypotheses)
    # laws share their readings: folds are laid out once for each set of these
    problems = {id(s.problem): s.problem for s in (searches[h.law] for h in asked)}
    folded = {key: _others_of_folds(problem) for key, problem in problems.items()}
    by_fold = []
    for h in asked:
        search = searches[h.law]
        others, _ = folded[id(search.problem)]
        densities = np.array(log_withheld(search, h, others))
        # the price of its forms, which were chosen with all folds, in equal parts
        by_fold.append(densities + search.log_form_prior(h) / len(densities))
    folds = np.array(by_fold)
    log_prior = np.array([h.log_prior for h in asked])
    log_evidence = np.array([h.log_evidence for h in asked])
    powers = log_powers(log_prior, log_evidence, folds)
    both = 0.5 * (log_evidence + folds.sum(axis=1))
    scores = log_posterior(log_prior, both, powers)
    scores += special.logsumexp([h.score for h in asked])
    results = {h.key: h for h in hypotheses}
    # an unknown process interpolates stretches of one run: they confirm no name, and
    # contradict none
    has_runs = all(are_runs for _, are_runs in folded.values())
    predictions = folds.sum(axis=1) if has_runs else np.full(len(asked), np.nan)
    for h, score, prediction in zip(asked, scores, predictions, strict=True):
        results[h.key] = dataclasses.replace(
            h, log_evidence=float(score) - h.log_prior, log_prediction=float(prediction)
        )
    return sorted(results.values(), key=lambda h: -h.score)


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


def log_powers(log_prior: Array, log_evidence: Array, by_fold: Array) -> Array:
    """Log posterior (T,) of powers of the evidence, by folds (H, F) of hypotheses."""
    log_others = log_evidence[:, None] - by_fold
    weights = log_prior[:, None] + POWERS[:, None, None] * log_others
    weights = special.log_softmax(weights, axis=1)
    predicted = special.logsumexp(weights + by_fold, axis=1).sum(axis=1)
    return np.asarray(special.log_softmax(predicted))


def log_posterior(log_prior: Array, log_evidence: Array, powers: Array) -> Array:
    """Log posterior (H,) of hypotheses, over the powers with log posterior (T,)."""
    values = special.log_softmax(log_prior + POWERS[:, None] * log_evidence, axis=1)
    return np.asarray(special.logsumexp(values + powers[:, None], axis=0))


def log_withheld(search: Search, h: Hypothesis, others: Sequence[Index]) -> list[float]:
    """Log predictive density of each fold, from `others`, in a hypothesis' forms."""
    problem, law = search.problem, search.law
    effects = h.columns(search.library, search.processes)
    columns = np.hstack([problem.slopes, effects])
    log_all = evidence.log_evidence(problem, law, columns)
    return [
        log_all - evidence.log_evidence(problem, law, columns, rows) for rows in others
    ]


def _others_of_folds(problem: GapProblem) -> tuple[list[Index], bool]:
    """Readings outside each fold, and whether folds are runs or stretches of one."""
    paths = Paths(problem)
    fold = paths.whole()[0]
    are_runs = bool(fold.max() > 0)
    if not are_runs:
        fold = paths.within()[0]
    return [np.flatnonzero(fold != k) for k in range(int(fold.max()) + 1)], are_runs
