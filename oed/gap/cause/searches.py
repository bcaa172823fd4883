"""Searches under noise laws that stand for all laws, without readings far off.

The laws are drawn with no gap, any gap, and the best gaps in the model
(`oed.gap.data.evidence`); every hypothesis that a search prefers is evaluated under each. A
large gap hides in the noise of the first laws: where that is far beyond what is stated,
the search goes on under the laws of its best gaps. Where the evidence of a likely gap
rests on few of the laws, more are drawn with that gap in the model.
"""

import functools
import itertools
from collections.abc import Sequence

import numpy as np

from oed import noise_law
from oed.base import Array
from oed.effect_model import Effect
from oed.gap.cause.compare import compare, probabilities
from oed.gap.cause.search import Hypothesis, Key, Search
from oed.gap.data import evidence
from oed.gap.data.columns import Block
from oed.gap.data.evidence import LawPosterior
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import discrepancy, waves
from oed.gap.forms import library as libraries
from oed.gap.forms.discrepancy import IN_A_RUN
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw
from oed.noise_law import Outliers

#: noise level, in units of the stated one, that is beyond its prior
MAX_NOISE_LEVEL = 2.0
Forms = tuple[tuple[int, ...], int | None]  #: a gap's atoms, and its process
N_CANDIDATES = 14  #: hypotheses of each first search that are evaluated under all laws
#: least root mean square of each effect and process in the wide model, in units of the
#: noise
WIDE_RMS = 0.7
#: size of a direction of the wide model, in units of the noise, that predicts no reading
UNSEEN_SIZE = 1e-4


def searches(problem: GapProblem, effects: Sequence[Effect]) -> list[Search]:
    """The search under each of the noise laws that stand for all."""
    plain = evidence.posterior(problem, evidence.compress(problem))
    library = libraries.build(problem, effects, Metric(problem, plain.mode))
    processes = discrepancy.build(problem)
    columns = wide_model(problem, library, processes)
    wide = evidence.posterior(problem, evidence.visible(columns))
    outliers = _outliers(problem, library, processes, wide.mode, columns)
    del columns  # of many readings they take much memory
    clean = without_outliers(problem, outliers)
    if outliers is not None:
        plain, wide = (evidence.posterior(clean, p.columns) for p in (plain, wide))
    unknown = waves.add(processes, clean, wide.mode)
    search_under = functools.partial(
        Search, clean, library, unknown, outliers=outliers, given=problem
    )
    first = [search_under(p.mode, 0.0) for p in (plain, wide)]
    gaps: dict[Forms, LawPosterior] = {}
    level = _add_best_gaps(gaps, first)
    if level > MAX_NOISE_LEVEL:
        further = [search_under(p.mode, 0.0) for p in gaps.values()]
        _add_best_gaps(gaps, further)
        first += further
    candidates = _candidates(first)

    def search_all(first_searches: Sequence[Search]) -> list[Search]:
        """Searches under all laws of the posteriors; the first laws may be searched."""
        mixture = evidence.mixture(clean, [plain, wide, *gaps.values()])
        pairs = zip(first_searches, mixture, strict=False)
        weighed = [search.with_weight(weight) for search, (_, weight) in pairs]
        further = [
            search_under(law, weight, candidates=candidates)
            for law, weight in mixture[len(first_searches) :]
        ]
        return [*weighed, *further]

    results = search_all(())
    count = len(gaps)
    _add_scarce(gaps, results)
    return results if len(gaps) == count else search_all(results)


def searches_under(
    problem: GapProblem, effects: Sequence[Effect], law: NoiseLaw
) -> list[Search]:
    """The search under a noise law that is known, with and without outliers."""
    library = libraries.build(problem, effects, Metric(problem, law))
    processes = discrepancy.build(problem)
    columns = wide_model(problem, library, processes)
    outliers = _outliers(problem, library, processes, law, columns)
    del columns
    results = []
    for removed in (None, outliers) if outliers is not None else (None,):
        clean = without_outliers(problem, removed)
        unknown = waves.add(processes, clean, law)
        results.append(
            Search(clean, library, unknown, law, 0.0, outliers=removed, given=problem)
        )
    return results


def _outliers(
    problem: GapProblem,
    library: Library,
    processes: Library,
    law: NoiseLaw,
    columns: Array,
) -> Outliers | None:
    """Outliers from the wide model, or from it with the gap that looks best added.

    A step's edges, say, are outliers from every smooth model; and outliers look like
    steps. The more probable explanation counts.

    columns  (N, k) of the wide model
    """
    outliers = detect_outliers(problem, law, columns)
    if outliers is None:
        return None

    def run(removed: Outliers | None) -> list[Hypothesis]:
        clean = without_outliers(problem, removed)
        return Search(clean, library, processes, law, 0.0, outliers=removed).run()

    gap = next(h for h in run(None) if h.is_gap)
    forms = gap.columns(library, processes)
    fewer = detect_outliers(problem, law, np.hstack([columns, forms]))
    return max((outliers, fewer), key=lambda removed: run(removed)[0].score)


def _candidates(first: Sequence[Search]) -> list[Hypothesis]:
    """No gap, an unknown, and each search's best hypotheses in their best forms."""
    best: dict[Key, Hypothesis] = {}
    for search in first:
        ranked = search.run()
        simple = [h for h in ranked[N_CANDIDATES:] if not h.effects]
        for h in ranked[:N_CANDIDATES] + simple:
            if h.key not in best or best[h.key].score < h.score:
                best[h.key] = h
    return list(best.values())


def _add_best_gaps(
    posteriors: dict[Forms, LawPosterior], searches: Sequence[Search]
) -> float:
    """Add the law's posterior with the best gap of each search in the model.

    The result is the highest noise level beside such a gap. The searches' products are
    not asked for again: they take much memory.
    """
    levels = []
    for search in searches:
        gap = next(h for h in search.run() if h.is_gap)
        levels.append(search.noise_level(gap))
        search.release()
        _add_gap(posteriors, search, gap)
    return max(levels)


def _add_gap(
    posteriors: dict[Forms, LawPosterior], search: Search, gap: Hypothesis
) -> None:
    """Add the law's posterior with a gap in the model, unless it is there."""
    forms = (tuple(sorted(gap.atoms)), gap.process)
    if forms not in posteriors:
        columns = gap.columns(search.library, search.processes)
        compressed = evidence.compress(search.problem, [Block.of(columns)])
        posteriors[forms] = evidence.posterior(search.problem, compressed)


def _add_scarce(
    posteriors: dict[Forms, LawPosterior], searches: Sequence[Search]
) -> None:
    """Add the posteriors with the likely gaps whose evidence rests on few laws."""
    hypotheses = compare(searches)
    for h, share in zip(hypotheses, probabilities(hypotheses), strict=True):
        if h.is_gap and share > 0.05 and h.effective_laws < 3.0:
            _add_gap(posteriors, searches[h.law], h)


# -- the wide model --------------------------------------------------------------------
def wide_model(problem: GapProblem, library: Library, processes: Library) -> Array:
    """Columns (N, k), compressed, of slopes, middle forms and broad processes."""
    forms = [_middle_form(library, effect) for effect in library.effects]
    broad = [effect for effect in processes.effects if effect != IN_A_RUN]
    forms += [_middle_form(processes, effect) for effect in broad]
    return evidence.compress(problem, itertools.chain(*forms), UNSEEN_SIZE)


def _middle_form(library: Library, effect: str) -> list[Block]:
    """The middle of an effect's widest forms, of the least root mean square."""
    forms = [library.atoms[k].columns for k in library.atoms_of(effect)]
    widest = max(len(form) for form in forms)
    full = [form for form in forms if len(form) == widest]
    middle = full[len(full) // 2]
    rms = np.sqrt((library.columns.take(middle) ** 2).sum() / len(library.columns))
    return library.columns.some(middle, WIDE_RMS / rms)


# -- outliers --------------------------------------------------------------------------
def detect_outliers(
    problem: GapProblem, law: NoiseLaw, columns: Array
) -> Outliers | None:
    """Outliers under a law, with columns (N, k) of prior N(0, 1), slopes too."""
    factor = law.factor(problem.structure).widened(columns)
    return noise_law.detect_outliers(
        problem.residual, factor, statement=problem.statement
    )


def without_outliers(problem: GapProblem, removed: Outliers | None) -> GapProblem:
    """The problem with pseudo-residuals in place of the outliers, if there are any."""
    if removed is None:
        return problem
    return problem.with_residual(removed.pseudo_residual)
