"""Chooses the runs of a second visit, which separate the answers of a diagnosis best.

What may act has the form and size that suit the readings taken best. Each of two
forms is a target to be separated from the other, with the readings taken, their
noise law and the parameters' priors in the model (`oed.gap.before.separation`): the
least lambda_{k|j} over all targets is maximised. Pairs that all candidates together
separate no further are no targets. `oed.gap.before.expected` says what it gains.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

from oed.base.arrays import Array, Index
from oed.design.plan_limits import TimeBudget
from oed.design.rules import Rules
from oed.gap.before import choose
from oed.gap.before.both_visits import answer_forms, both_visits, law_of_both
from oed.gap.before.expected import (
    AnswerForm,
    coefficients,
    expected_probability,
    probability_now,
)
from oed.gap.before.runs import Run, lay_out, separation
from oed.gap.before.separation import Separation, Target
from oed.gap.cause.advice import SURE
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.measurement.measurement import Series
from oed.model.effect import Effect
from oed.noise.law import NoiseLaw
from oed.result.gap_before import SeparationRecord

#: share of the readings taken that a second visit has at most
SHARE = 0.25
#: numbers of the likeliest pairs of answers that a plan separates: of such plans the one
#: counts after which the right answer is likeliest
PAIRS = (12, 2)
#: lambda that all candidates together must add to a pair
ADDED = 1.0
#: share of D in the choice, rounds of the search
VOLUME, ROUNDS = 0.02, 4


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


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """Columns of an answer among those of all, of prior N(0, 1).

    effect       the answer in words
    at           (k,) its columns
    size         (k,) its coefficients, as the readings taken give them
    probability  of the answer
    """

    effect: str
    at: Index
    size: Array
    probability: float

    @property
    def precision(self) -> Array:
        """Of each coefficient: 1."""
        return np.ones(len(self.at))


def needs_second_visit(diagnosis: Diagnosis) -> bool:
    """Whether the first answer is a class or unknown, or not sure beside another that shows."""
    first, *others = diagnosis.answers
    if diagnosis.verdict in ("class", "scatter", "unknown"):
        return True
    if any(len(c) > 1 for c in first.classes):
        return True
    unseen = sum(answer.unseen for answer in diagnosis.answers)
    sure = first.probability + (0.0 if first.effects else unseen)
    return sure < SURE and any(answer.visible > 0.0 for answer in others)


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
    poses = sum(len(s) for s in taken.series)
    cost = np.array([len(run.command) for run in candidates], dtype=float)
    budget = SHARE * poses
    possible = [run for run, c in zip(candidates, cost, strict=True) if c <= budget]
    if not possible:
        return None
    both, rows = both_visits(taken, possible)
    law = law_of_both(diagnosis.law, taken, both)
    forms = answer_forms(diagnosis, taken, both, law, effects)
    pools = [
        _pool(both, law, rows, forms, np.arange(len(taken)), count) for count in PAIRS
    ]
    time = TimeBudget(cost[cost <= budget], budget)
    outlook = _Outlook(both, law, forms, len(taken), rng.spawn(1)[0])
    visits = []
    for pool, inseparable in pools:
        if pool is None:
            continue
        plan = choose.choose(pool, Rules(time=time), rng, share=VOLUME, rounds=ROUNDS)
        runs = [possible[k] for k in plan.runs]
        chosen = np.concatenate([rows[k] for k in plan.runs])
        visits.append(_visit(runs, chosen, outlook, plan.pairs, inseparable))
    return max(visits, key=lambda v: v.probability_after, default=None)


class _Outlook:
    """What the answers expect of readings to come, by one set of random numbers."""

    def __init__(
        self,
        both: GapProblem,
        law: NoiseLaw,
        forms: Sequence[AnswerForm],
        taken: int,
        rng: np.random.Generator,
    ) -> None:
        self.both, self.law, self.forms = both, law, forms
        self._seed = int(rng.integers(2**32))
        self._columns = [np.hstack([both.slopes, form.columns]) for form in forms]
        whiten = law.factor(both, np.arange(taken)).whiten
        self._taken = [whiten(columns) for columns in self._columns]
        self._residual = whiten(both.residual[:, None])[:, 0]

    def after(self, chosen: Index) -> float:
        """Expected probability of the right answer after the readings `chosen`."""
        whiten = self.law.factor(self.both, chosen).whiten
        return expected_probability(
            self.forms,
            self._taken,
            self._residual,
            [whiten(columns) for columns in self._columns],
            np.random.default_rng(self._seed),
        )


def _visit(
    runs: Sequence[Run],
    chosen: Index,
    outlook: _Outlook,
    pairs: Sequence[SeparationRecord],
    inseparable: Sequence[tuple[str, str]],
) -> SecondVisit:
    """A visit of chosen runs, with what it gains."""
    series, covariates = lay_out(outlook.both.measurement, runs)
    return SecondVisit(
        runs=tuple(runs),
        series=series,
        covariates=covariates.drop(columns="time", errors="ignore"),
        probability_now=probability_now(outlook.forms),
        probability_after=outlook.after(chosen),
        pairs=tuple(pairs),
        inseparable=tuple(inseparable),
    )


# -- targets ---------------------------------------------------------------------------


def _pool(
    both: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    forms: Sequence[AnswerForm],
    first: Index,
    count: int,
) -> tuple[Separation | None, list[tuple[str, str]]]:
    """The separation of the likely answers by the candidates, and pairs that none separates."""
    columns, parts = _parts(both, law, forms, first)
    pairs = [
        (a.probability * b.probability, Target(a, a.size, "", b))
        for a, b in itertools.permutations(parts, 2)
        if len(a.at)
    ]
    pairs.sort(key=lambda pair: -pair[0])
    targets = [target for _, target in pairs[:count]]
    if not targets:
        return None, []
    pool = separation(both, law, rows, columns, targets, first)
    gain = pool.lambdas(pool.of(np.arange(pool.count))) - pool.lambdas(pool.base)
    open_targets = [k for k, added in enumerate(gain) if added > ADDED]
    separable = {frozenset(targets[k].key[:2]) for k in open_targets}
    every = dict.fromkeys(tuple(sorted(target.key[:2])) for target in targets)
    closed = [(a, b) for a, b in every if frozenset((a, b)) not in separable]
    return (pool.with_targets(open_targets) if open_targets else None), closed


def _parts(
    both: GapProblem, law: NoiseLaw, forms: Sequence[AnswerForm], first: Index
) -> tuple[Array, list[_Part]]:
    """Columns (N, K) of the answers, each in its likeliest form, and their places."""
    likeliest: dict[tuple[str, ...], AnswerForm] = {}
    for form in sorted(forms, key=lambda form: -form.probability):
        likeliest.setdefault(form.effects, form)
    whiten = law.factor(both, first).whiten
    residual = whiten(both.residual[:, None])[:, 0]
    blocks, start = [np.zeros((len(both), 0))], 0
    parts = []
    for form in likeliest.values():
        at = np.arange(start, start + form.columns.shape[1])
        start += len(at)
        white = whiten(np.hstack([both.slopes, form.columns]))
        size = coefficients(white, residual)[0][both.slopes.shape[1] :]
        parts.append(_Part(_words(form.effects), at, size, form.probability))
        blocks.append(form.columns)
    return np.hstack(blocks), parts


def _words(effects: Sequence[str]) -> str:
    return " + ".join(effects) if effects else "nothing"
