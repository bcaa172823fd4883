"""Diagnosis of residuals: noise law, effects, places, closure and advice."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from oed.base.arrays import Array
from oed.gap.cause import advice, answers, closure
from oed.gap.cause.compare import compare_expanded, probabilities
from oed.gap.cause.explained import explain
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.scatter import (
    excess_scatter,
    rough_scatter,
    unstated_scatter,
    with_roughness,
)
from oed.gap.cause.search import Search
from oed.gap.cause.searches import searches, searches_under
from oed.gap.data.diagnosis import (
    NO_EFFECT,
    UNKNOWN,
    AnswerContent,
    Closure,
    Diagnosis,
)
from oed.gap.data.problem import GapProblem
from oed.gap.places import place
from oed.gap.places.draws import LikelyForms, ReversedForms
from oed.model.effect import Effect
from oed.noise.law import NoiseLaw, describe
from oed.result.gap import PlaceRecord

#: forms that an unknown remainder is reported to be like, at most, and the least
#: probability of each
LIKE, LEAST_LIKE = 3, 0.03
#: ways of holding readings out
SPLITS: tuple[closure.Split, ...] = ("within", "whole")
#: factors on the selected sizes, and likeliest forms of each effect, between which
#: training readings choose
FACTORS, FORMS = (1.0, 0.5, 2.0), 5
#: share from which a form counts where the gap is located
LEAST_SHARE = 0.01
#: part of an unknown alone from which it is rough rather than smooth
EVEN = 0.5


def diagnose(
    problem: GapProblem,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    law: NoiseLaw | None = None,
) -> Diagnosis:
    """Diagnose residuals with a library of effects.

    `law` is the noise law where it is known but for its level; by default the readings
    determine it.

    >>> import numpy as np
    >>> import pandas as pd
    >>> from oed import Measurement, mount
    >>> from oed.gap import diagnose, prepare
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.effects.encoder_scale import effect
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> covariates = pd.DataFrame(
    ...     {"setup": "tracker", "run": "1", "order": np.arange(25), "direction": 1}
    ... )
    >>> problem = prepare(measurement, [series], y, covariates)
    >>> diagnose(problem, [effect], rng).verdict
    'none'
    """
    diagnosis, best, search_results, hypotheses = _conclusion(problem, effects, law)
    clean = search_results[best.law].problem  # without outliers, where there are any
    where: tuple[PlaceRecord, ...] = ()
    if diagnosis.verdict in NO_EFFECT:
        # the closure by the likeliest effect is reported all the same, nil or not
        named = (h for h in hypotheses if h.effects and not h.unknown)
        best = next(named, best)
    else:
        search = search_results[best.law]
        where = _locate(search, best, effects, diagnosis.law, rng)
    closures = _closures(clean, search_results[best.law], best, diagnosis.law, rng)
    return dataclasses.replace(diagnosis, where=where, closure=closures)


def explain_residuals(
    problem: GapProblem, effects: Sequence[Effect], *, law: NoiseLaw | None = None
) -> Diagnosis:
    """As `diagnose`, without places and closure: which effects act."""
    return _conclusion(problem, effects, law)[0]


def _conclusion(
    problem: GapProblem, effects: Sequence[Effect], law: NoiseLaw | None
) -> tuple[Diagnosis, Hypothesis, Sequence[Search], Sequence[Hypothesis]]:
    """The diagnosis, its hypothesis, and the searches and hypotheses behind it."""
    comparison = compare_expanded(
        problem, effects, lambda about: _searches(about, effects, law)
    )
    diagnosis, best = conclude(
        problem, comparison.searches, comparison.hypotheses, effects
    )
    return diagnosis, best, comparison.searches, comparison.hypotheses


def _searches(
    problem: GapProblem,
    effects: Sequence[Effect],
    law: NoiseLaw | None,
) -> list[Search]:
    """Searches under all noise laws that suit, or under the one that is known."""
    if law is None:
        return searches(problem, effects)
    return searches_under(problem, effects, law)


def conclude(
    problem: GapProblem,
    search_results: Sequence[Search],
    hypotheses: Sequence[Hypothesis],
    effects: Sequence[Effect],
) -> tuple[Diagnosis, Hypothesis]:
    """The diagnosis by searches under several noise laws, without places and closure.

    The second result is the hypothesis that the first answer stands for.
    """
    hypotheses, rough = with_roughness(search_results, hypotheses)
    shares = probabilities(hypotheses)
    groups = answers.group(search_results, hypotheses, shares)
    ranked, leading = answers.rank(groups)
    first, best = ranked[0], leading[0]
    is_rough = answers.verdict(first) == "unknown" and rough.share > EVEN
    if is_rough:
        best = next(h for h in hypotheses if not h.is_gap)
    search = search_results[best.law]
    named = {name for members in first.classes for name in members}
    if not named & set(best.effects):
        named = set(best.effects)
    parts = explain(search.given, search, best, named)
    law = search.law_at(parts.level)
    untested = search.library.not_testable
    verdict, scatter = answers.verdict(first), None
    if is_rough:
        scatter = rough_scatter(search.problem, law, rough)
    elif verdict == "none":
        scatter = excess_scatter(search.given, law)
    diagnosis = Diagnosis(
        problem=search.given,
        verdict=verdict if scatter is None else "scatter",
        scatter=scatter,
        answers=ranked,
        set95=answers.credible_set(groups),
        marginal=_marginal(search.library.effects, hypotheses, shares),
        law=law,
        noise_words=describe(law, problem.longest),
        constants=_constants(search, best, [size.effect for size in parts.sizes]),
        coefficients=parts.coefficients,
        sizes=parts.sizes,
        explained=parts.explained * problem.sigma,
        unexplained=parts.unexplained * problem.sigma,
        likeness=_likeness(search, best),
        before=parts.before * problem.sigma,
        after=parts.after * problem.sigma,
        where=(),
        closure=(),
        not_testable=untested,
        confusable=tuple(dict.fromkeys(c for c in first.classes if len(c) > 1)),
        next=advice.advise(
            ranked,
            effects,
            untested,
            scatter=scatter,
            unstated=unstated_scatter(search.given, law),
        ),
        effective_laws=best.effective_laws if _is_estimated(search_results) else None,
        clean=search.problem,
        shares=dict(zip([h.key for h in hypotheses], shares.tolist(), strict=True)),
        contents=_contents(search_results, leading),
    )
    return diagnosis, best


def _contents(
    search_results: Sequence[Search], leading: Sequence[Hypothesis]
) -> tuple[AnswerContent, ...]:
    """What hypotheses say, each in the form that suits it best."""
    return tuple(
        AnswerContent(_constants(search_results[h.law], h, h.effects), h.unknown)
        for h in leading
    )


def _is_estimated(search_results: Sequence[Search]) -> bool:
    """Whether there are several noise laws, rather than a known one."""
    return any(search.law is not search_results[0].law for search in search_results)


def _constants(
    search: Search,
    best: Hypothesis,
    effects: Collection[str],
) -> dict[str, Mapping[str, float]]:
    """{effect: constants of its best form} of some of a hypothesis' effects."""
    forms = zip(best.effects, best.atoms, strict=True)
    atoms = search.library.atoms
    return {effect: atoms[k].constants for effect, k in forms if effect in effects}


def _likeness(search: Search, best: Hypothesis) -> dict[str, float]:
    """The likeliest few forms of the unknown remainder, with probabilities."""
    if best.process is None:
        return {}
    likeliest = list(search.likeness(best).items())[:LIKE]
    return {form: share for form, share in likeliest if share > LEAST_LIKE}


def _marginal(
    names: Iterable[str],
    hypotheses: Sequence[Hypothesis],
    shares: Array,
) -> dict[str, float]:
    """{effect: probability that it acts}, and that of an unknown remainder."""
    pairs = list(zip(hypotheses, shares, strict=True))
    marginal = {
        name: float(sum(p for h, p in pairs if name in h.effects)) for name in names
    }
    return marginal | {UNKNOWN: float(sum(p for h, p in pairs if h.unknown))}


# -- places ----------------------------------------------------------------------------


def _locate(
    search: Search,
    best: Hypothesis,
    effects: Sequence[Effect],
    law: NoiseLaw,
    rng: np.random.Generator,
) -> tuple[PlaceRecord, ...]:
    """Places in which the gap lies, over all likely forms of the best hypothesis."""
    library, processes = search.library, search.processes
    other_way = ReversedForms(search.problem, library, processes, effects)
    level = search.noise_level(best)
    parts = len(best.effects) + best.unknown
    models = [
        LikelyForms(
            share,
            h.columns(library, processes, level),
            h.labels(library, processes),
            np.array(h.timed(library, processes)),
            other_way.columns(h, level),
        )
        for part in range(parts)
        for share, h in search.forms(best, part)
        if share > LEAST_SHARE
    ]
    return place.locate(search.problem, law, models, rng)


# -- closure ---------------------------------------------------------------------------


def _closures(
    problem: GapProblem,
    search: Search,
    best: Hypothesis,
    law: NoiseLaw,
    rng: np.random.Generator,
) -> tuple[Closure, ...]:
    """How far the gap shrinks on held-out readings, by parts of runs and whole runs."""
    # without effects the closure is that of a column that changes nothing
    models = _models(search, best) or [np.zeros((len(problem), 1))]
    return tuple(
        closure.closure(problem, law, models, rng, split=split) for split in SPLITS
    )


def _models(search: Search, best: Hypothesis) -> list[Array]:
    """Columns (N, k), at their sizes, between which training readings choose.

    The selected forms at other sizes, and with the next best forms of each effect.
    """
    models: dict[tuple[tuple[int, float], ...], Array] = {}
    level = search.noise_level(best)

    def add(atoms: Sequence[int], sizes: Sequence[float]) -> None:
        h = dataclasses.replace(best, atoms=tuple(atoms), sizes=tuple(sizes))
        columns = h.columns(search.library, search.processes, level)
        if columns.shape[1]:
            models[tuple(zip(atoms, sizes, strict=True))] = columns

    for i in range(max(len(best.atoms), 1)):
        for factor in FACTORS:
            sizes = [s * factor if j == i else s for j, s in enumerate(best.sizes)]
            add(best.atoms, sizes)
        for _, h in search.forms(best, i)[:FORMS] if best.atoms else []:
            add(h.atoms, h.sizes)
    return list(models.values())
