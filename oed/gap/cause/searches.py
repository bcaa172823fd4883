"""Searches under noise laws that stand for all laws, without readings far off.

The laws are drawn with no gap, any gap, and the best gaps in the model
(`oed.gap.data.laws`); every hypothesis that a search prefers is evaluated under each. A
large gap hides in the noise of the first laws: where that is far beyond what is stated,
the search goes on under the laws of its best gaps.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from oed.gap.cause.hypothesis import Hypothesis, Key
from oed.gap.cause.search import Search
from oed.gap.cause.wide import wide_model
from oed.gap.data import laws, noise
from oed.gap.data.laws import LawPosterior
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy, waves
from oed.gap.forms import library as libraries
from oed.gap.forms.library import Library
from oed.model.effect import Effect
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers

#: noise level, in units of the stated one, that is beyond its prior
LOUD = 2.0
#: a gap's atoms, and its process
Forms = tuple[tuple[int, ...], int | None]
#: hypotheses of each first search that are evaluated under all laws
CANDIDATES = 14


def searches(problem: GapProblem, effects: Sequence[Effect]) -> list[Search]:
    """The search under each of the noise laws that stand for all."""
    nothing = np.zeros((len(problem), 0))
    plain = laws.posterior(problem, nothing)
    library = libraries.build(problem, effects, Metric(problem, plain.mode))
    processes = discrepancy.build(problem)
    columns = wide_model(library, processes)
    wide = laws.posterior(problem, columns)
    outliers = _outliers(problem, library, processes, wide.mode)
    clean = noise.without_outliers(problem, outliers)
    if outliers is not None:
        plain, wide = laws.posterior(clean, nothing), laws.posterior(clean, columns)
    unknown = waves.add(processes, clean, wide.mode)

    def search_under(posteriors: Iterable[LawPosterior]) -> list[Search]:
        return [
            Search(clean, library, unknown, p.mode, 0.0, outliers) for p in posteriors
        ]

    first = search_under((plain, wide))
    gaps: dict[Forms, LawPosterior] = {}
    _add_best_gaps(gaps, clean, first)
    further: list[Search] = []
    if any(search.noise_level(_best_gap(search)) > LOUD for search in first):
        further = search_under(list(gaps.values()))
        _add_best_gaps(gaps, clean, further)
    candidates = _candidates([*first, *further])
    every = [plain, wide, *gaps.values()]
    return [
        Search(clean, library, unknown, law, weight, outliers, candidates, problem)
        for law, weight in laws.mixture(clean, every)
    ]


def searches_under(
    problem: GapProblem,
    effects: Sequence[Effect],
    law: NoiseLaw,
) -> list[Search]:
    """The search under a noise law that is known, with and without outliers."""
    library = libraries.build(problem, effects, Metric(problem, law))
    processes = discrepancy.build(problem)
    outliers = _outliers(problem, library, processes, law)
    results = []
    for removed in (None, outliers) if outliers is not None else (None,):
        clean = noise.without_outliers(problem, removed)
        unknown = waves.add(processes, clean, law)
        results.append(
            Search(clean, library, unknown, law, 0.0, removed, given=problem)
        )
    return results


def _outliers(
    problem: GapProblem, library: Library, processes: Library, law: NoiseLaw
) -> Outliers | None:
    """Outliers from the wide model, or from it with the gap that looks best added.

    A step's edges, say, are outliers from every smooth model; and outliers look like
    steps. The more probable explanation counts.
    """
    columns = wide_model(library, processes)
    outliers = noise.detect_outliers(problem, law, columns)
    if outliers is None:
        return None
    gap = _best_gap(Search(problem, library, processes, law, 0.0))
    forms = gap.columns(library, processes)
    fewer = noise.detect_outliers(problem, law, np.hstack([columns, forms]))

    def score(removed: Outliers | None) -> float:
        clean = noise.without_outliers(problem, removed)
        return Search(clean, library, processes, law, 0.0, removed).run()[0].score

    return max((outliers, fewer), key=score)


def _best_gap(search: Search) -> Hypothesis:
    """The best hypothesis of a search that says there is a gap."""
    return next(h for h in search.run() if h.is_gap)


def _candidates(first: Sequence[Search]) -> list[Hypothesis]:
    """The best hypotheses of each search, in the form of the one that it suits best.

    No gap and an unknown alone are always among them.
    """
    best: dict[Key, Hypothesis] = {}
    for search in first:
        ranked = search.run()
        simple = [h for h in ranked[CANDIDATES:] if not h.effects]
        for h in ranked[:CANDIDATES] + simple:
            if h.key not in best or best[h.key].score < h.score:
                best[h.key] = h
    return list(best.values())


def _add_best_gaps(
    posteriors: dict[Forms, LawPosterior],
    problem: GapProblem,
    searches: Sequence[Search],
) -> None:
    """Add the law's posterior with the best gap of each search in the model."""
    for search in searches:
        gap = _best_gap(search)
        forms = (tuple(sorted(gap.atoms)), gap.process)
        if forms not in posteriors:
            columns = gap.columns(search.library, search.processes)
            posteriors[forms] = laws.posterior(problem, columns)
