"""Searches under each of the noise laws that suit the readings, with and without outliers.

The noise law is not known before the gap is. It is fitted with nothing in the model,
with the wide model, and with each gap that a search prefers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.effect import Effect
from oed.gap.cause import pursuit
from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.cause.wide import wide_model
from oed.gap.data import evidence, noise
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as libraries
from oed.gap.forms import marks, spots, waves
from oed.gap.forms.library import Library
from oed.gap.forms.processes.catalogue import PROCESSES
from oed.noise import estimate
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers

#: log evidence of no gap, and of a gap, by which a law must be better to be added
BETTER, CLEARLY = 0.1, 0.3
#: change of a reading, in units of the stated noise, from which on outliers of another
#: model are other outliers
OTHER = 1.0
#: differences of two laws' shares, and of the logs of their reaches, below which the
#: laws are the same
SAME_SHARES, SAME_REACH = 0.05, 0.2

#: a noise law and its log prior
WeighedLaw = tuple[NoiseLaw, float]
#: forms and unknown process that a law was fitted with
Forms = tuple[tuple[int, ...], int | None]


def searches(problem: GapProblem, effects: Sequence[Effect]) -> list[Search]:
    """The search under each of the noise laws that suit the readings."""
    nothing = np.zeros((len(problem), 0))
    plain = noise.fit_law(problem, nothing)
    library = libraries.build(problem, effects, Metric(problem, plain[0]))
    processes = libraries.build(problem, PROCESSES)
    columns = wide_model(library, processes)
    wide = noise.fit_law(problem, columns, plain[0])
    outliers = noise.detect_outliers(problem, wide[0], columns)
    if outliers is None:
        return _search(problem, library, processes, [plain, wide])
    clean = noise.without_outliers(problem, outliers)
    wide = noise.fit_law(clean, columns, wide[0])
    # once more, since the first law was fitted with the outliers
    outliers = noise.detect_outliers(problem, wide[0], columns) or outliers
    clean = noise.without_outliers(problem, outliers)
    laws = [
        noise.fit_law(clean, nothing, plain[0]),
        noise.fit_law(clean, columns, wide[0]),
    ]
    results = _search(clean, library, processes, laws, outliers)
    # what looks like an outlier may be a gap, within a run at that
    located = _add_located(processes, problem, plain[0])
    raw = Search(problem, library, located, *plain)
    results.append(raw)
    best = _best_gap(compare(results))
    gaps = [(raw, _best_gap(raw.run()))]
    if results[best.law] is not raw:
        gaps.append((results[best.law], best))
    for search, gap in gaps:
        results += _with_gap(problem, search, gap, columns, outliers)
    return results


def searches_under(
    problem: GapProblem,
    effects: Sequence[Effect],
    law: NoiseLaw,
) -> list[Search]:
    """The search under a noise law that is known, with and without outliers."""
    library = libraries.build(problem, effects, Metric(problem, law))
    processes = libraries.build(problem, PROCESSES)
    columns = wide_model(library, processes)
    outliers = noise.detect_outliers(problem, law, columns)
    results = []
    for removed in (None, outliers) if outliers is not None else (None,):
        clean = noise.without_outliers(problem, removed)
        located = _add_located(processes, clean, law)
        combined, _ = pursuit.pursue(located, clean, [law], known=True)
        results.append(Search(clean, library, combined, law, 0.0, removed))
    return results


def _search(
    problem: GapProblem,
    library: Library,
    processes: Library,
    laws: Sequence[WeighedLaw],
    outliers: Outliers | None = None,
) -> list[Search]:
    """The search under some laws with their log priors, and all that these lead to.

    The first law was fitted with nothing in the model.
    """
    plain = laws[0][0]
    quiet = estimate.without_run_noise(plain)
    laws = [*laws, quiet]
    processes = _add_located(processes, problem, plain)
    processes, pursued = pursuit.pursue(processes, problem, [plain, quiet[0]])
    for pair in pursued:
        if not any(_same(pair[0], law) for law, _ in laws):
            laws = [*laws, pair]
    results = [Search(problem, library, processes, *pair, outliers) for pair in laws]
    # the gap that each law prefers gets the law that suits it: a load's runs, say,
    # then do not count as poor repeats
    tried: set[Forms] = set()
    for start in list(results):
        _add_refitted(results, start, _best_gap(start.run()), tried)
    best = _best_gap(compare(results))
    _add_refitted(results, results[best.law], best, tried)
    best = _best_gap(compare(results))
    _add_without_gap(results, results[best.law].law)
    return results


def _add_located(
    processes: Library,
    problem: GapProblem,
    law: NoiseLaw,
) -> Library:
    """The processes with those that could sit anywhere: waves, fine marks, spots."""
    for kind in (waves, marks, spots):
        processes = kind.add(processes, problem, law)
    return processes


def _best_gap(hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """The best hypothesis that says there is a gap."""
    return next(h for h in hypotheses if h.is_gap)


def _with_gap(
    problem: GapProblem,
    search: Search,
    gap: Hypothesis,
    columns: Array,
    before: Outliers,
) -> list[Search]:
    """Searches without the outliers from a gap, where these are others than `before`.

    A step's edges, say, are outliers from every smooth model.
    """
    forms = gap.columns(search.library, search.processes)
    both = np.hstack([columns, forms])
    outliers = noise.detect_outliers(problem, search.law, both)
    clean = noise.without_outliers(problem, outliers)
    if np.abs(clean.residual - before.pseudo_residual).max() < OTHER:
        return []
    nothing = np.zeros((len(problem), 0))
    results = []
    for model in (nothing, forms):
        law = noise.fit_law(clean, model, search.law)
        results.append(Search(clean, search.library, search.processes, *law, outliers))
    return results


def _add_refitted(
    results: list[Search],
    start: Search,
    best: Hypothesis,
    tried: set[Forms],
) -> None:
    """Add the search under the law that suits a hypothesis.

    Not if its forms were tried, or another law suits it as well.
    """
    forms = (tuple(sorted(best.atoms)), best.process)
    if forms in tried:
        return
    tried.add(forms)
    columns = best.columns(start.library, start.processes)
    pair = noise.fit_law(start.problem, columns, start.law)
    laws = [pair, *((s.law, s.log_prior) for s in results)]
    new, *others = _log_evidences(start.problem, columns, laws)
    if new > max(others) + CLEARLY:
        results.append(_again(start, pair))


def _add_without_gap(results: list[Search], start: NoiseLaw) -> None:
    """Add the search under the law that suits no gap best, from the best gap's law on.

    What a gap gains by a law fitted to it, no gap should gain too.
    """
    first = results[0]
    nothing = np.zeros((len(first.problem), 0))
    pair = noise.fit_law(first.problem, nothing, start)
    new = _log_evidences(first.problem, nothing, [pair])[0]
    if new > max(s.grams.base + s.log_prior for s in results) + BETTER:
        results.append(_again(first, pair))


def _again(search: Search, pair: WeighedLaw) -> Search:
    """The same search under another law."""
    problem, outliers = search.problem, search.outliers
    return Search(problem, search.library, search.processes, *pair, outliers)


def _log_evidences(
    problem: GapProblem,
    columns: Array,
    laws: Sequence[WeighedLaw],
) -> list[float]:
    """Log evidence with columns (N, k) in the model under each law, with its prior."""
    compressed = evidence.compress(problem, columns)
    return [
        evidence.log_evidence(problem, law, compressed) + log_prior
        for law, log_prior in laws
    ]


def _same(a: NoiseLaw, b: NoiseLaw) -> bool:
    """Whether two laws are nearly the same."""
    shares = [np.array([law.run_sd, law.ar1_sd, law.run_harmonic_sd]) for law in (a, b)]
    if np.abs(shares[0] - shares[1]).max() >= SAME_SHARES:
        return False
    return bool(abs(np.log(a.ar1_length) - np.log(b.ar1_length)) < SAME_REACH)
