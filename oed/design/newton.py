"""Newton steps over the free weights of an active set, within caps and at a fixed sum.

A weight at a bound that wants to leave it is free. A step is bent at the bounds, so
that many weights can reach them at once, with more damping where the step is too long.
Where no such step raises the value, it goes straight to the first bound, or shifts
weight from the least wanted candidate to the most wanted one.
"""

from __future__ import annotations

import numpy as np

from oed.base import Array, Index
from oed.design.objective import Objective

#: Newton steps in a call, at the most
STEPS = 8
#: damping of a step, as a share of the mean curvature: more where the step does not
#: raise the value
DAMPING = (1e-10, 1e-6, 1e-3, 1e-1, 1e1)
#: a weight within this share of a bound is put on the bound
AT_BOUND = 1e-13
#: halvings of a straight step, and the least share of it
HALVINGS, LEAST_SHARE = 20, 1e-6


def newton_steps(
    objective: Objective, active: Index, weights: Array, caps: Array
) -> Array:
    """Weights (A,) after Newton steps; each step raises the value."""
    for _ in range(STEPS):
        # a weight within rounding of a bound would stop every step at once
        capped = np.where(weights > caps * (1.0 - AT_BOUND), caps, weights)
        weights = np.where(weights < AT_BOUND * caps, 0.0, capped)
        improved = _one_step(objective, active, weights, caps)
        if improved is None:
            break
        weights = improved
    return weights


def scale_to_size(weights: Array, size: float, caps: Array) -> Array:
    """Weights scaled to the sum `size`; what exceeds a cap goes to the others."""
    weights = np.maximum(weights, 1e-12)
    for _ in range(100):
        full = weights >= caps
        missing = size - caps[full].sum()
        if missing < 0.0:  # those at their caps are too many already
            within = np.minimum(weights, caps)
            scaled: Array = within * (size / within.sum())
            return scaled
        others = weights[~full].sum()
        factor = missing / others if others > 0 else 1.0
        weights = np.where(full, caps, weights * factor)
        if not (weights > caps * (1 + 1e-15)).any():
            break
    return np.minimum(weights, caps)


def _one_step(
    objective: Objective, active: Index, weights: Array, caps: Array
) -> Array | None:
    """Weights after one step that raises the value; None where no step does."""
    slopes, curvature = objective.slopes_and_curvature(active, weights)
    value = objective.value(active, weights)
    longest: tuple[Array, Index] | None = None
    for damping in DAMPING:
        step, free = _newton_direction(slopes, curvature, weights, caps, damping)
        if not free.size:
            break
        longest = longest or (step, free)
        total = float(weights[free].sum())
        bent = weights.copy()
        bent[free] = project_to_sum(weights[free] + step, total, caps[free])
        if objective.value(active, bent) > value:
            return bent
    # last: it releases one weight at a time, and wide blocks have hundreds to release
    if longest is not None:
        straight = _straight_step(objective, active, weights, *longest, caps)
        if straight is not None:
            return straight
    step, free = _pair_direction(slopes, curvature, weights, caps)
    if not free.size:
        return None
    return _straight_step(objective, active, weights, step, free, caps)


def _newton_direction(
    slopes: Array, curvature: Array, weights: Array, caps: Array, damping: float
) -> tuple[Array, Index]:
    """Newton step over the free weights that preserves their sum, and these weights."""
    free = _free_weights(slopes, weights, caps)
    while free.size > 1:
        hessian = curvature[np.ix_(free, free)]
        # more free weights than distinct information: the ridge picks the shortest of
        # the equal steps
        ridge = damping * np.trace(hessian) / len(free) + 1e-300
        hessian[np.diag_indices_from(hessian)] += ridge
        right = np.column_stack([slopes[free], np.ones(len(free))])
        by_slopes, by_ones = np.linalg.solve(hessian, right).T
        step = by_slopes - by_slopes.sum() / by_ones.sum() * by_ones
        below = (weights[free] <= 0) & (step < 0)
        above = (weights[free] >= caps[free]) & (step > 0)
        outward = below | above
        if not outward.any():
            return step, free
        free = free[~outward]
    return np.zeros(0), free[:0]


def _free_weights(slopes: Array, weights: Array, caps: Array) -> Index:
    """Weights inside their bounds, and those that want to leave a bound."""
    inside = (weights > 0) & (weights < caps)
    if inside.any():
        inner_weights = np.where(inside, weights, 0.0)
        multiplier = float(np.average(slopes, weights=inner_weights))
    else:
        multiplier = float(slopes.mean())
    leaves_zero = (weights <= 0) & (slopes > multiplier)
    leaves_cap = (weights >= caps) & (slopes < multiplier)
    return np.flatnonzero(inside | leaves_zero | leaves_cap)


def _pair_direction(
    slopes: Array, curvature: Array, weights: Array, caps: Array
) -> tuple[Array, Index]:
    """Newton step from the least wanted weight to the most wanted one."""
    giver = int(np.argmin(np.where(weights > 0, slopes, np.inf)))
    taker = int(np.argmax(np.where(weights < caps, slopes, -np.inf)))
    gain = slopes[taker] - slopes[giver]
    if not gain > 1e-12 * abs(slopes[taker]):
        return np.zeros(0), np.zeros(0, dtype=np.intp)
    pair = np.array([taker, giver])
    direction = np.array([1.0, -1.0])
    bend = float(direction @ curvature[np.ix_(pair, pair)] @ direction)
    room = min(float(caps[taker] - weights[taker]), float(weights[giver]))
    step = min(gain / max(bend, 1e-300), room)
    return np.array([step, -step]), pair


def _straight_step(
    objective: Objective,
    active: Index,
    weights: Array,
    step: Array,
    free: Index,
    caps: Array,
) -> Array | None:
    """Weights after the longest feasible share of a step that raises the value."""
    start, value = weights[free], objective.value(active, weights)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_cap = np.where(step > 0, (caps[free] - start) / step, np.inf)
        room = np.where(step < 0, start / -step, to_cap)
    share = min(1.0, float(room.min()))
    if share < LEAST_SHARE:
        return None
    for _ in range(HALVINGS):
        trial = weights.copy()
        trial[free] = np.clip(start + share * step, 0.0, caps[free])
        if objective.value(active, trial) > value:
            return trial
        share *= 0.5
    return None


def project_to_sum(wanted: Array, total: float, caps: Array) -> Array:
    """The nearest weights within 0 and the caps that have the sum `total`."""
    shift = _shift_to_sum(wanted, total, caps)
    projected = np.minimum(np.maximum(wanted - shift, 0.0), caps)
    inside = (projected > 0) & (projected < caps)
    if inside.any():
        projected[inside] += (total - projected.sum()) / inside.sum()
    return np.minimum(np.maximum(projected, 0.0), caps)


def _shift_to_sum(wanted: Array, total: float, caps: Array) -> float:
    """The number to subtract from all weights, so that within 0 and the caps they have
    the sum `total`.

    The sum is piecewise linear in the shift: it bends where a weight leaves its cap, and
    where one reaches 0.
    """
    bends = np.concatenate([wanted - caps, wanted])
    order = np.argsort(bends)
    bends = bends[order]
    inside = np.cumsum(np.where(order < len(wanted), 1.0, -1.0))
    drops = inside[:-1] * np.diff(bends)
    sums = caps.sum() - np.append(0.0, np.cumsum(drops))
    last = max(int(np.count_nonzero(sums > total)) - 1, 0)
    excess = sums[last] - total
    return float(bends[last] + excess / max(inside[last], 1.0))
