"""Equivalence classes: effects that are indistinguishable from a selected effect.

The part of the readings that effect k explains, y_k = G_k beta_k, is fitted by a rival
j: what j cannot absorb of it, with the parameters and the other selected effects
absorbing too, is lambda_{k|j}. Where its root is below 5 the readings cannot
distinguish the two, and both belong to the answer. Where nearly all of y_k is absorbed,
no readings of this kind could.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed.arrays import Array, Index
from oed.gap.cause.hypothesis import Hypothesis, Key
from oed.gap.cause.search import Search
from oed.gap.data.evidence import SIZES, Grams

#: sqrt(lambda_{k|j}) below which a rival is indistinguishable from an effect
DISTINCT = 5.0
#: share of lambda_k that a rival leaves, below which no reading of this kind
#: distinguishes them
EXACT = 0.002
#: largest size, against its physical prior scale, that a rival may have
RIVAL = float(SIZES[-1])


def equivalent_effects(
    search: Search,
    h: Hypothesis,
    scores: Mapping[Key, float],
    alive: float,
) -> list[tuple[str, ...]]:
    """For each effect of a hypothesis the names indistinguishable from it, itself first.

    scores    log posterior of hypotheses by their key
    alive     how far behind in log posterior a rival may be that absorbs not nearly all
    """
    classes = []
    for i, effect in enumerate(h.effects):
        others = h.others(i)
        parts = [search.columns_of(h.atoms[j]) for j in others]
        selected = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        grams = search.grams.project_out(selected)
        members = [effect]
        for rival in search.library.effects:
            if rival in h.effects:
                continue
            distinct, whole = _distinct_energy(search, grams, h, i, rival)
            exact = distinct < EXACT * whole
            replaced = frozenset({rival, *(h.effects[j] for j in others)})
            score = scores.get((replaced, h.unknown), -np.inf)
            near = score > h.score - alive
            if exact or (distinct < DISTINCT**2 and near):
                members.append(rival)
        classes.append(tuple(members))
    return classes


def _distinct_energy(
    search: Search,
    grams: Grams,
    h: Hypothesis,
    i: int,
    rival: str,
) -> tuple[float, float]:
    """lambda_{k|j} and lambda_k of the i-th effect of h.

    The rival has the form that absorbs most.
    """
    columns = search.columns_of(h.atoms[i])
    beta = posterior_mean(grams, columns, h.sizes[i])
    whole = float(beta @ grams.gram[np.ix_(columns, columns)] @ beta)
    least = whole
    for atom in search.library.atoms_of(rival):
        form = search.columns_of(atom)
        cross = grams.gram[np.ix_(form, columns)] @ beta
        precision = np.eye(len(form)) / RIVAL**2
        inner = grams.gram[np.ix_(form, form)] + precision
        absorbed = float(cross @ np.linalg.solve(inner, cross))
        least = min(least, whole - absorbed)
    return max(least, 0.0), whole


def posterior_mean(grams: Grams, columns: Index, size: float) -> Array:
    """Posterior mean of the coefficients of `columns`, of prior N(0, size^2)."""
    precision = np.eye(len(columns)) / size**2
    inner = grams.gram[np.ix_(columns, columns)] + precision
    return np.asarray(np.linalg.solve(inner, grams.b[columns]))
