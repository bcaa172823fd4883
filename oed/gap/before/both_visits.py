"""The readings taken and candidates of a second visit as one problem, and its answers there.

The likely sets of effects of a diagnosis have the forms and sizes that suit the readings
taken best, and the columns that these forms have in the readings of both visits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd

from oed.base.arrays import Index
from oed.gap.before.expected import AnswerForm
from oed.gap.before.repeats import with_other_covariates
from oed.gap.before.runs import Run, lay_out
from oed.gap.cause.hypothesis import PRIOR, Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import UNKNOWN, Diagnosis
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem, assemble
from oed.gap.forms import discrepancy
from oed.gap.forms import library as libraries
from oed.gap.forms.library import Library
from oed.model.effect import Effect
from oed.noise.law import NoiseLaw

#: least probability of a set of effects that counts, sets at most, likely forms of each
LEAST, MOST, FORMS = 0.01, 8, 3


def both_visits(
    taken: GapProblem, candidates: Sequence[Run]
) -> tuple[GapProblem, list[Index]]:
    """The readings taken and all candidates as one problem, and each run's rows in it."""
    series, covariates = lay_out(taken.measurement, candidates)
    rows = with_other_covariates(covariates, taken.covariates)
    to_come = taken.measurement.readings(series, taken.theta)
    both = assemble(
        taken.measurement,
        [*taken.series, *series],
        pd.concat([taken.covariates, rows], ignore_index=True),
        taken.theta,
        np.concatenate([taken.y, to_come]),
        gravity=taken.gravity,
    )
    unread = np.zeros(len(both) - len(taken))
    both = both.with_residual(np.concatenate([taken.residual, unread]))
    later = both.rows.iloc[len(taken) :].reset_index(drop=True)
    at = later.groupby(["setup", "run"], sort=False).indices
    members = [at[run.setup, run.name] + len(taken) for run in candidates]
    return both, [np.asarray(m, dtype=np.intp) for m in members]


def law_of_both(law: NoiseLaw, taken: GapProblem, both: GapProblem) -> NoiseLaw:
    """A noise law of the readings taken, for those to come as well."""
    count = len(both) - len(taken)
    variance = np.append(law.variance, np.full(count, np.median(law.variance)))
    ratio = law.channel_ratio
    if ratio is not None:
        of_channel = dict(zip(taken.channel.tolist(), ratio.tolist(), strict=True))
        later = [of_channel[c] for c in both.channel[len(taken) :].tolist()]
        ratio = np.append(ratio, later)
    return dataclasses.replace(law, variance=variance, channel_ratio=ratio)


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
    single = dataclasses.replace(law, level=1.0)
    first = np.arange(len(taken))
    library = libraries.build(both, involved, Metric(both, single, first))
    processes = discrepancy.build(both)
    of_taken = dataclasses.replace(diagnosis.law, level=1.0)
    search = Search(
        taken,
        _of_rows(library, first),
        _of_rows(processes, first),
        of_taken,
        0.0,
    )
    forms: list[AnswerForm] = []
    for (named, unknown), share in likely:
        if named <= set(library.effects):
            best = _best_form(search, sorted(named), unknown)
            parts = _forms(search, best, library, processes, law.level)
            forms += [
                dataclasses.replace(part, probability=share * part.probability)
                for part in parts
            ]
    return forms


def _of_rows(library: Library, rows: Index) -> Library:
    return dataclasses.replace(library, columns=library.columns[rows])


def _best_form(search: Search, names: Sequence[str], unknown: bool) -> Hypothesis:
    """A set of effects in the forms that suit the readings taken best."""
    chosen: list[str] = []
    atoms: list[int] = []
    sizes: list[float] = []
    while len(chosen) < len(names):
        grams = search.grams_with(atoms, sizes)
        others = [name for name in search.library.effects if name not in names]
        further = search.screen(grams, [*others, *chosen])
        best = max(further, key=lambda name: further[name].log_evidence)
        chosen.append(best)
        atoms.append(further[best].atom)
        sizes.append(further[best].size)
    form = search.fit(chosen, atoms, sizes)
    return search.add_unknown(form) if unknown else form


def _forms(
    search: Search,
    best: Hypothesis,
    library: Library,
    processes: Library,
    level: float,
) -> list[AnswerForm]:
    """A hypothesis in its likely forms, with their shares."""
    forms = [(1.0, best)]
    if best.effects or best.unknown:
        forms = search.forms(best, 0)[:FORMS]
    total = sum(share for share, _ in forms)
    words = (*sorted(best.effects), UNKNOWN) if best.unknown else sorted(best.effects)
    unseen = PRIOR["none"] / (PRIOR["none"] + PRIOR["unseen"])
    right = 1.0 if best.is_gap else unseen
    # a remainder beside named effects is the same answer
    answer = tuple(words) if not best.effects else tuple(sorted(best.effects))
    return [
        AnswerForm(answer, share / total, h.columns(library, processes, level), right)
        for share, h in forms
    ]
