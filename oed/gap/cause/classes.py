"""Equivalence classes: which other effects could have made what a selected effect
explains.

The part of the readings that effect k explains, y_k = G_k beta_k, is given to a rival
j: what j cannot absorb of it, with the parameters and the other selected effects
absorbing too, is lambda_{k|j}. Where its root is below 5 the readings cannot tell the
two (and where nearly all of y_k is absorbed, they never could): both belong to the
answer.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed.arrays import Array, Index
from oed.gap.cause.which import Hypothesis, Search
from oed.gap.data.evidence import SIZES, Grams

#: sqrt(lambda_{k|j}) below which a rival may stand for an effect
TELLS = 5.0
#: share of lambda_k that a rival leaves, below which no reading of this kind tells them
#: apart
EXACT = 0.002
#: largest size, against its physical prior scale, that a rival is granted
RIVAL = float(SIZES[-1])


def of(
    search: Search,
    h: Hypothesis,
    scores: Mapping[tuple[frozenset[str], bool], float],
    alive: float,
) -> list[tuple[str, ...]]:
    """For each effect of a hypothesis the names that may stand in its place, itself
    first.

    scores: log posterior of hypotheses by their key;  alive: how far behind a rival may
                                                       be and still count where it
    is not an exact one.
    """
    found = []
    for i, effect in enumerate(h.effects):
        others = [j for j in range(len(h.effects)) if j != i]
        left = search.grams.project_out(
            np.concatenate(
                [
                    np.empty(0, dtype=np.intp),
                    *[search.columns_of(h.atoms[j]) for j in others],
                ]
            )
        )
        members = [effect]
        for rival in search.library.effects:
            if rival in h.effects:
                continue
            kept, whole = _left(search, left, h, i, rival)
            key = (frozenset({rival, *(h.effects[j] for j in others)}), h.unknown)
            near = scores.get(key, -np.inf) > h.score - alive
            if kept < EXACT * whole or (kept < TELLS**2 and near):
                members.append(rival)
        found.append(tuple(members))
    return found


def _left(
    search: Search, left: Grams, h: Hypothesis, i: int, rival: str
) -> tuple[float, float]:
    """lambda_{k|j} and lambda_k of the i-th effect of h, for the form of the rival that
    absorbs most.
    """
    mine = search.columns_of(h.atoms[i])
    beta = posterior_mean(left, mine, h.sizes[i])
    whole = float(beta @ left.gram[np.ix_(mine, mine)] @ beta)
    kept = whole
    for atom in search.library.atoms_of(rival):
        theirs = search.columns_of(atom)
        cross = left.gram[np.ix_(theirs, mine)] @ beta
        inner = left.gram[np.ix_(theirs, theirs)] + np.eye(len(theirs)) / RIVAL**2
        kept = min(kept, whole - float(cross @ np.linalg.solve(inner, cross)))
    return max(kept, 0.0), whole


def posterior_mean(found: Grams, columns: Index, size: float) -> Array:
    """Posterior mean of the coefficients of `columns`, of prior N(0, size^2)."""
    inner = found.gram[np.ix_(columns, columns)] + np.eye(len(columns)) / size**2
    return np.asarray(np.linalg.solve(inner, found.b[columns]))
