"""Chooses the runs of a second visit, which separate the answers of a diagnosis best.

What may act has the form and size that suit the readings taken best, and the columns that
this form has in the readings of both visits. Of the two likeliest answers that all
candidates together separate further, each is a target to be separated from the other, with
the readings taken, their noise law and the parameters' priors in the model
(`oed.gap.before.separation`): the least lambda_{k|j} is maximised.
`oed.gap.before.expected` says what the visit gains.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from oed.base import Array, Index
from oed.design import Rules
from oed.effect_model import Effect
from oed.gap.before import choose
from oed.gap.before.expected import (
    AnswerForm,
    coefficients,
    expected_probability,
    probability_now,
)
from oed.gap.before.forms import ColumnSet
from oed.gap.before.repeats import with_other_covariates
from oed.gap.before.runs import Run, lay_out, rows_of_runs, separation
from oed.gap.before.separation import Separation, Target
from oed.gap.cause.advice import is_sure
from oed.gap.cause.hypothesis import PRIOR
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import UNKNOWN, Diagnosis
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem, assemble
from oed.gap.forms import discrepancy
from oed.gap.forms import library as libraries
from oed.measurement import Series
from oed.noise import NoiseLaw
from oed.result import SeparationRecord

#: share of the readings taken that a second visit has at most
SHARE = 0.25
#: ordered pairs of the likeliest answers that are tried, and how many of those that the
#: candidates separate a plan is for: more pairs leave the likeliest less well separated
PAIRS, SEPARATED = 12, 2
#: lambda that all candidates together must add to a pair
ADDED = 1.0
#: share of D in the choice, rounds of the search
VOLUME, ROUNDS = 0.02, 4
#: least probability of a set of effects that counts, sets at most, likely forms of each
LEAST, MOST, FORMS = 0.01, 8, 3


@dataclasses.dataclass(frozen=True, kw_only=True)
class SecondVisit:
    """A second visit.

    runs              in the order in which they are to be taken
    series            their readings, with one row of `covariates` each
    probability_now   of the likeliest set of effects
    probability_after  expected probability that the likeliest is right after the visit
    pairs             what the runs separate, ascending
    inseparable       pairs of answers that no candidate separates
    """

    runs: tuple[Run, ...]
    series: tuple[Series, ...]
    covariates: pd.DataFrame
    probability_now: float
    probability_after: float
    pairs: tuple[SeparationRecord, ...]
    inseparable: tuple[tuple[str, str], ...]


def needs_second_visit(diagnosis: Diagnosis) -> bool:
    """Whether the first answer is a class or unknown, or not sure beside another that shows."""
    return (
        diagnosis.verdict in ("class", "scatter", "unknown")
        or any(len(c) > 1 for c in diagnosis.answers[0].classes)
        or not is_sure(diagnosis.answers)
    )


def propose(
    diagnosis: Diagnosis,
    effects: Sequence[Effect],
    candidates: Sequence[Run],
    rng: np.random.Generator,
) -> SecondVisit | None:
    """The runs that separate the answers of a diagnosis best; None where none does.

    They have at most a quarter of the readings that the diagnosis rests on.
    """
    taken = diagnosis.problem if diagnosis.clean is None else diagnosis.clean
    budget = SHARE * sum(len(s) for s in taken.series)
    possible = [run for run in candidates if len(run.command) <= budget]
    if not possible:
        return None
    both, rows = both_visits(taken, possible)
    law = law_of_both(diagnosis.law, taken, both)
    forms = answer_forms(diagnosis, taken, both, law, effects)
    first = np.arange(len(taken))
    pool, inseparable = _pool(both, law, rows, forms, first)
    if pool is None:
        return None
    cost = np.array([len(run.command) for run in possible], dtype=float)
    rules = Rules.build(seconds=cost, budget=budget)
    plan = choose.choose(pool, rules, rng, share=VOLUME, rounds=ROUNDS)
    runs = tuple(possible[k] for k in plan.runs)
    series, covariates = lay_out(taken.measurement, runs)
    columns = [np.hstack([both.slopes, form.columns]) for form in forms]
    taken_readings = law.factor(both.structure, first)
    to_come = law.factor(both.structure, np.concatenate([rows[k] for k in plan.runs]))
    after = expected_probability(
        forms,
        [taken_readings.whiten(values) for values in columns],
        taken_readings.whiten(both.residual[:, None])[:, 0],
        [to_come.whiten(values) for values in columns],
        rng,
    )
    return SecondVisit(
        runs=runs,
        series=series,
        covariates=covariates.drop(columns="time", errors="ignore"),
        probability_now=probability_now(forms),
        probability_after=after,
        pairs=tuple(plan.pairs),
        inseparable=tuple(inseparable),
    )


# -- both visits as one problem --------------------------------------------------------


def both_visits(
    taken: GapProblem, candidates: Sequence[Run]
) -> tuple[GapProblem, tuple[Index, ...]]:
    """The readings taken and all candidates as one problem, and each run's rows in it."""
    series, covariates = lay_out(taken.measurement, candidates)
    rows = with_other_covariates(covariates, taken.covariates)
    both = assemble(
        taken.measurement,
        [*taken.series, *series],
        pd.concat([taken.covariates, rows], ignore_index=True),
        taken.theta,
        gravity=taken.gravity,
    )
    unread = np.zeros(len(both) - len(taken))
    both = both.with_residual(np.concatenate([taken.residual, unread]))
    return both, rows_of_runs(both, candidates, len(taken))


def law_of_both(law: NoiseLaw, taken: GapProblem, both: GapProblem) -> NoiseLaw:
    """A noise law of the readings taken, for those to come as well.

    Channels that were not read are as the first one.
    """
    more = len(both.structure.names) - len(taken.structure.names)
    scale = np.pad(law.law.scale, ((0, 0), (0, more)), constant_values=1.0)
    return dataclasses.replace(law, law=dataclasses.replace(law.law, scale=scale))


def answer_forms(
    diagnosis: Diagnosis,
    taken: GapProblem,
    both: GapProblem,
    law: NoiseLaw,
    effects: Sequence[Effect],
) -> list[AnswerForm]:
    """The likely sets of effects, each in its likely forms, the likeliest first.

    Forms and sizes are those of the readings taken, columns those of both visits.
    """
    likely = sorted(diagnosis.shares.items(), key=lambda item: -item[1])[:MOST]
    likely = [(key, share) for key, share in likely if share >= LEAST]
    names = {name for (named, _), _ in likely for name in named}
    involved = [effect for effect in effects if effect.name in names]
    first, single = np.arange(len(taken)), dataclasses.replace(law, level=1.0)
    library = libraries.build(both, involved, Metric(both, single, first))
    processes = discrepancy.build(both)
    search = Search(
        taken,
        dataclasses.replace(library, columns=library.columns[first]),
        dataclasses.replace(processes, columns=processes.columns[first]),
        dataclasses.replace(diagnosis.law, level=1.0),
        0.0,
    )
    by_key = {h.key: h for h in search.run()}
    answers: list[AnswerForm] = []
    for key, share in likely:
        best = by_key.get(key)
        if best is None:
            continue
        forms = search.forms(best, 0)[:FORMS] if best.is_gap else [(1.0, best)]
        total = sum(part for part, _ in forms)
        # a remainder beside named effects is the same answer
        named = tuple(sorted(best.effects)) or (UNKNOWN,) * best.unknown
        right = PRIOR["none"] / (PRIOR["none"] + PRIOR["unseen"])
        answers += [
            AnswerForm(
                effects=named,
                probability=share * part / total,
                columns=form.columns(library, processes, law.level),
                share_right=1.0 if best.is_gap else right,
            )
            for part, form in forms
        ]
    return answers


# -- targets ---------------------------------------------------------------------------


def _pool(
    both: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    forms: Sequence[AnswerForm],
    first: Index,
) -> tuple[Separation | None, list[tuple[str, str]]]:
    """The separation of the likely answers by the candidates, and pairs that none separates."""
    columns, parts = _parts(both, law, forms, first)
    pairs = [
        (p * q, Target(answer, size, "", rival))
        for (answer, size, p), (rival, _, q) in itertools.permutations(parts, 2)
        if len(size)
    ]
    pairs.sort(key=lambda pair: -pair[0])
    targets = [target for _, target in pairs[:PAIRS]]
    if not targets:
        return None, []
    pool = separation(both, law, rows, columns, targets, first)
    gain = pool.lambdas(pool.of(np.arange(pool.count))) - pool.lambdas(pool.base)
    open_targets = np.flatnonzero(gain > ADDED).tolist()
    separable = {frozenset(targets[k].key[:2]) for k in open_targets}
    every = dict.fromkeys(tuple(sorted(target.key[:2])) for target in targets)
    closed = [(a, b) for a, b in every if frozenset((a, b)) not in separable]
    if not open_targets:
        return None, closed
    return pool.with_targets(open_targets[:SEPARATED]), closed


def _parts(
    both: GapProblem, law: NoiseLaw, forms: Sequence[AnswerForm], first: Index
) -> tuple[Array, list[tuple[ColumnSet, Array, float]]]:
    """Columns (N, K) of the answers, each in its likeliest form.

    Then of each its columns, of prior N(0, 1), their coefficients as the readings taken
    give them, and its probability.
    """
    likeliest: dict[tuple[str, ...], AnswerForm] = {}
    for form in sorted(forms, key=lambda form: -form.probability):
        likeliest.setdefault(form.effects, form)
    whiten = law.factor(both.structure, first).whiten
    residual = whiten(both.residual[:, None])[:, 0]
    start, parts = 0, []
    for form in likeliest.values():
        at = np.arange(start, start + form.columns.shape[1])
        start += len(at)
        white = whiten(np.hstack([both.slopes, form.columns]))
        size = coefficients(white, residual)[0][both.slopes.shape[1] :]
        words = " + ".join(form.effects) or "nothing"
        columns = ColumnSet(words, at, np.ones(len(at)))
        parts.append((columns, size, form.probability))
    blocks = [form.columns for form in likeliest.values()]
    return np.hstack([np.zeros((len(both), 0)), *blocks]), parts
