"""Diagnosis of residuals: noise law, effects, places, closure and advice."""

import dataclasses
import functools
from collections.abc import Collection, Sequence

import numpy as np

from oed.base import Array
from oed.effect_model import Effect
from oed.gap.cause import answers, closure, locations, withheld
from oed.gap.cause.compare import (
    MAX_RIVAL_SIZE,
    Comparison,
    SearchOf,
    compare_expanded,
    posterior_mean,
    probabilities,
    without,
    without_implausible,
)
from oed.gap.cause.locations import LikelyForms, ReversedForms
from oed.gap.cause.scatter import (
    excess_scatter,
    rough_scatter,
    unstated_scatter,
    with_roughness,
)
from oed.gap.cause.search import Hypothesis, Key, Search
from oed.gap.cause.searches import searches, searches_under
from oed.gap.data.diagnosis import NO_EFFECT, AnswerContent, Diagnosis, Explained, Size
from oed.gap.data.evidence import grams_of
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms.discrepancy import JOINTS, READINGS, part_in_words
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw
from oed.result import UNKNOWN, CoefficientRecord, PlaceRecord

#: closure below which names are refuted: their correction more than doubles what it
#: should remove from withheld readings
MIN_CLOSURE = -1.0


# What the best hypothesis explains of the residual: coefficients, sizes, remainder.
def explain(
    problem: GapProblem, search: Search, h: Hypothesis, named: Collection[str]
) -> Explained:
    """Parts of the residual by a hypothesis.

    Effects that are not `named` count with what is unknown. `problem` has the
    residuals with their outliers, `search` without.
    """
    metric = Metric(problem, search.law)
    library = search.library
    residual = search.problem.residual
    level = search.noise_level(h)
    columns = h.columns(library, search.processes)
    mean, precision = metric.posterior(columns, residual)
    sd = level * np.sqrt(np.diag(np.linalg.inv(precision)))
    by_effects = np.zeros(len(problem))
    constants = {}
    coefficients = []
    sizes = []
    start = 0
    stated = Metric(search.problem, search.problem.stated_law)
    for effect, atom, size in zip(h.effects, h.atoms, h.sizes, strict=True):
        rows = library.atoms[atom].columns
        columns_of = slice(start, start + len(rows))
        start = columns_of.stop
        if effect not in named:
            continue
        constants[effect] = library.atoms[atom].constants
        signal = columns[:, columns_of] @ mean[columns_of]
        by_effects = by_effects + signal
        unit = size * np.array(library.scales)[rows]
        for c, value, of_value in zip(
            rows, mean[columns_of] * unit, sd[columns_of] * unit, strict=True
        ):
            record = CoefficientRecord(
                effect=effect,
                name=library.names[c],
                label=library.labels[c],
                value=float(value),
                sd=float(of_value),
                unit="SI",
                prior_sd=None,
            )
            coefficients.append(record)
        energy = float(metric.gram(signal[:, None], signal[:, None])[0, 0])
        detectability = float(np.sqrt(max(energy, 0.0))) / level
        rms = _rms_by_channel(problem, signal)
        remaining = _rms_by_channel(problem, stated.fit_remainder(signal))
        sizes.append(Size(effect, rms, remaining, detectability))
    outlying = problem.residual - residual
    before = stated.fit_remainder(residual) + outlying
    after = stated.fit_remainder(residual - by_effects) + outlying
    return Explained(
        constants=constants,
        coefficients=tuple(coefficients),
        sizes=tuple(sizes),
        explained=by_effects * problem.sigma,
        unexplained=(columns @ mean - by_effects) * problem.sigma,
        before=before * problem.sigma,
        after=after * problem.sigma,
    )


def _noise_words(problem: GapProblem, law: NoiseLaw) -> tuple[str, ...]:
    """The law in sentences; an assumed noise was replaced by that of the fit before."""
    is_assumed = problem.statement.is_assumed
    unit = "the noise of the fit" if is_assumed else "the stated noise"
    return law.describe(problem.structure.longest, unit)


def nearest_effects(search: Search, h: Hypothesis) -> tuple[str, ...]:
    """Effects that explain most of an unknown remainder, the nearest first.

    With s what the remainder changes, an effect's share is the largest s^T M G (G^T M G
    + 1 / t^2)^-1 G^T M s / s^T M s of its forms G, at the largest usual size t.
    """
    if h.process is None:
        return ()
    problem, library = search.problem, search.library
    metric = Metric(problem, search.law)
    columns = h.columns(library, search.processes)
    coefficients, _ = metric.posterior(columns, problem.residual)
    of_process = len(search.processes.atoms[h.process].columns)
    change = columns[:, -of_process:] @ coefficients[-of_process:]
    every = np.arange(library.columns.shape[1])
    changed = problem.with_residual(change)
    grams = grams_of(changed, metric, library.columns, every)
    shares: dict[str, float] = {}
    for atom in library.atoms:
        mean = posterior_mean(grams, atom.columns, MAX_RIVAL_SIZE)
        share = float(grams.b[atom.columns] @ mean) / grams.energy
        shares[atom.effect] = max(share, shares.get(atom.effect, 0.0))
    near = [name for name, share in shares.items() if share >= 0.5]
    return tuple(sorted(near, key=lambda name: -shares[name])[:4])


def _rms_by_channel(problem: GapProblem, signal: Array) -> dict[str, float]:
    """Root mean square, SI, of a change of the readings in each channel."""
    values = signal * problem.sigma
    channels = problem.rows["channel"].to_numpy()
    return {
        str(name): float(np.sqrt(np.mean(values[channels == name] ** 2)))
        for name in dict.fromkeys(channels)
    }


SPLITS: tuple[closure.Split, ...] = ("within", "whole")  #: ways of holding readings out


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
    comparison = _compare(problem, effects, law)
    refuted: list[Key] = []
    while True:
        diagnosis, best = conclude(comparison, effects, refuted)
        if diagnosis.verdict in NO_EFFECT:
            nothing = tuple(closure.not_scored(split) for split in SPLITS)
            return dataclasses.replace(diagnosis, closure=nothing)
        search = comparison.searches[best.law]
        where = _locate(search, best, effects, diagnosis.law, rng)
        models = withheld.models(search, best)
        closures = tuple(
            # without outliers, where there are any
            closure.closure(search.problem, diagnosis.law, models, rng, split=split)
            for split in SPLITS
        )
        is_harmful = any((c.value or 0.0) < MIN_CLOSURE for c in closures)
        if not best.effects or not is_harmful or best.key in refuted:
            break
        refuted.append(best.key)
    return dataclasses.replace(diagnosis, where=where, closure=closures)


def explain_residuals(
    problem: GapProblem, effects: Sequence[Effect], *, law: NoiseLaw | None = None
) -> Diagnosis:
    """As `diagnose`, without places and closure: which effects act."""
    return conclude(_compare(problem, effects, law), effects)[0]


def _compare(
    problem: GapProblem, effects: Sequence[Effect], law: NoiseLaw | None
) -> Comparison:
    """Hypotheses under all noise laws that suit, or under the one that is known."""
    search: SearchOf = functools.partial(searches, effects=effects)
    if law is not None:
        search = functools.partial(searches_under, effects=effects, law=law)
    return compare_expanded(problem, effects, search)


def conclude(
    comparison: Comparison, effects: Sequence[Effect], refuted: Sequence[Key] = ()
) -> tuple[Diagnosis, Hypothesis]:
    """The diagnosis by searches under several noise laws, without places and closure.

    The second result is the hypothesis that the first answer stands for. What `refuted`
    names is not concluded.
    """
    searched = comparison.searches
    hypotheses, left_out = _believed(comparison, refuted)
    hypotheses, rough = with_roughness(searched, hypotheses)
    shares = probabilities(hypotheses)
    groups = answers.group(searched, hypotheses, shares)
    ranked, leading = answers.rank(groups)
    first = ranked[0]
    best = leading[0]
    verdict = answers.verdict(ranked[0])
    is_rough = verdict == "unknown" and rough > 0.5
    if is_rough:
        best = next(h for h in hypotheses if not h.is_gap)
    search = searched[best.law]
    law = search.law_at(search.noise_level(best))
    untested = search.library.not_testable
    named = {name for members in first.classes for name in members}
    if not named & set(best.effects):
        named = set(best.effects)
    scatter = None
    if is_rough:
        scatter = rough_scatter(search.problem, law)
    elif verdict == "none":
        scatter = excess_scatter(search.given, law)
    unstated = unstated_scatter(search.given, law)
    is_law_known = all(s.law is searched[0].law for s in searched)
    diagnosis = Diagnosis(
        **vars(explain(search.given, search, best, named)),
        problem=search.given,
        verdict=verdict if scatter is None else "scatter",
        scatter=scatter,
        answers=ranked,
        set95=answers.credible_set(groups),
        marginal={
            name: float(shares[[name in h.names for h in hypotheses]].sum())
            for name in (*search.library.effects, UNKNOWN)
        },
        law=law,
        noise_words=_noise_words(search.given, law),
        likeness=_likeness(search, best),
        nearest=nearest_effects(search, best),
        where=(),
        closure=(),
        not_testable=untested,
        confusable=tuple(dict.fromkeys(c for c in first.classes if len(c) > 1)),
        next=answers.advise(
            ranked, effects, untested, scatter=scatter, unstated=unstated
        ),
        effective_laws=None if is_law_known else best.effective_laws,
        clean=search.problem,
        shares=dict(zip([h.key for h in hypotheses], shares.tolist(), strict=True)),
        contents=tuple(
            AnswerContent(searched[h.law].constants(h), h.unknown) for h in leading
        ),
        left_out=left_out,
    )
    return diagnosis, best


def _believed(
    comparison: Comparison, refuted: Sequence[Key]
) -> tuple[list[Hypothesis], tuple[str, ...]]:
    """Hypotheses, best first, as withheld runs leave them, and names left out."""
    pooled = withheld.pooled(comparison.searches, comparison.hypotheses)
    believed, left_out = without_implausible(comparison.searches, pooled)
    for key in refuted:
        believed = without(believed, key)
        left_out = (*left_out, *sorted(key[0]))
    return believed, tuple(dict.fromkeys(left_out))


def _likeness(search: Search, best: Hypothesis) -> dict[str, float]:
    """The likeliest few forms of the unknown remainder in words, with probabilities."""
    by_form: dict[str, float] = {}
    if best.process is not None:
        for share, h in search.forms(best, len(best.effects)):
            of, atom, _ = h.forms(search.library, search.processes)[-1]
            about = _described(of, atom)
            by_form[about] = by_form.get(about, 0.0) + share
    likeliest = sorted(by_form.items(), key=lambda item: -item[1])[:3]
    return {form: share for form, share in likeliest if share > 0.03}


def _described(of: Library, atom: int) -> str:
    """A form in words, by the part of its carrier where it acts in one alone."""
    about = of.atoms[atom].about
    labels = {of.labels[c] for c in of.atoms[atom].columns}
    if len(labels) > 1 or not all(labels):
        return about
    part = part_in_words(labels.pop())
    if part in about:
        return about
    return about.replace(JOINTS, part).replace(READINGS, part)


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

    def likely(share: float, h: Hypothesis) -> LikelyForms:
        forms = [(of, of.atoms[atom]) for of, atom, _ in h.forms(library, processes)]
        return LikelyForms(
            share=share,
            columns=h.columns(library, processes, level),
            labels=[of.labels[c] for of, atom in forms for c in atom.columns],
            timed=np.array([atom.timed for _, atom in forms for _ in atom.columns]),
            other_way=other_way.columns(h, level),
        )

    models = [
        likely(share, h)
        for part in range(len(best.effects) + best.unknown)
        for share, h in search.forms(best, part)
        if share > 0.01
    ]
    return locations.locate(search.problem, law, models, rng)
