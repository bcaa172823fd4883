"""The best that any plan under given rules could be: a valid bound, and how loose it
may be.

Concave criteria: the relaxation's bound. Rules about set-ups are met by bounding every
combination of set-ups by itself where there are few, and are left out (which only
raises the bound) where there are many; so are distances. E and the condition number
have relaxations of their own.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.design import condition, relaxation
from oed.design.criterion import Criterion, Spectrum
from oed.design.relaxation import Relaxed
from oed.design.rules import Rules


@dataclasses.dataclass(frozen=True)
class Bound:
    """No plan exceeds `value` (log phi); `gap` is how loose it is known to be at the
    most, as a relaxation.

    weights, slopes (C,): of the relaxation that attains it, to lead the search
    """

    value: float
    gap: float
    weights: Array
    slopes: Array


def bound(
    blocks: Array,
    criterion: Criterion,
    rules: Rules,
    prior: Array,
    tolerance: float = 1e-8,
) -> Bound:
    """Bound over all plans under the rules, for a concave criterion."""
    best: Bound | None = None
    parts: dict[bytes, Bound] = {}
    for candidates, total, cost in rules.limits(len(blocks)):
        found = _relaxed(blocks[candidates], criterion, total, cost, prior, tolerance)
        told = _spread(found, candidates, cost, len(blocks))
        key = candidates.tobytes()
        # number and budget both hold: the lower of their bounds does
        parts[key] = (
            told if key not in parts or told.value < parts[key].value else parts[key]
        )
    for told in parts.values():
        best = told if best is None or told.value > best.value else best
    if best is None:
        raise ValueError("the budget does not pay for mounting any set-up")
    return best


def _relaxed(
    blocks: Array,
    criterion: Criterion,
    total: float,
    cost: Array | None,
    prior: Array,
    tolerance: float,
) -> Relaxed:
    """The relaxation, over v = cost w where a cost is told."""
    scaled = blocks if cost is None else blocks / np.sqrt(cost)[:, None, None]
    cap = 1.0 if cost is None else cost
    if isinstance(criterion, Spectrum):
        best = condition.e_optimal(scaled, total, prior, cap)
        value, above = criterion.least * np.log([max(best.value, 1e-300), best.bound])
        return Relaxed(best.weights, float(value), float(above), best.slopes)
    return relaxation.relax(scaled, total, prior, cap, tolerance, criterion)


def _spread(found: Relaxed, candidates: Index, cost: Array | None, count: int) -> Bound:
    weights, slopes = np.zeros(count), np.zeros(count)
    per = np.ones(len(candidates)) if cost is None else cost
    weights[candidates] = found.weights / per
    slopes[candidates] = found.slopes
    return Bound(found.bound, found.gap, weights, slopes)


def condition_bound(
    blocks: Array, criterion: Criterion, rules: Rules, prior: Array
) -> Bound | None:
    """Bound of kappa, O2 and O4, for plans of a stated number of readings; None where a
    budget rules.

    More readings can make the condition number worse, so a plan within a budget need
    not use it up.
    """
    if (
        rules.size is None
        or rules.budget is not None
        or not isinstance(criterion, Spectrum)
    ):
        return None
    size = float(rules.size)
    if criterion.name == "O4":
        best = condition.o4(blocks, size, prior)
        return Bound(float(np.log(best.bound)), best.gap, best.weights, best.slopes)
    found = condition.relax(blocks, size, prior)
    return Bound(-float(np.log(found.bound)), found.gap, found.weights, found.slopes)
