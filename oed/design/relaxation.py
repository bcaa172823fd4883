"""Optimal weights: the convex relaxation of the choice, solved to rounding, with its
certificate.

    maximise  log phi(M0 + sum_i w_i X_i^T X_i)   over  0 <= w_i <= cap_i,  sum_i w_i = N.

Every exact plan of N candidates is feasible (cap 1: no repeats; cap inf: repeats
allowed), so the optimum bounds it. Method: an active set of candidates, on which Newton
steps are taken in the face of the free weights, with the criterion's own curvature;
candidates whose slope exceeds the multiplier join, weights that reach a bound leave.
Where Newton steps end, the equivalence theorem (Kiefer and Wolfowitz 1960; Pukelsheim
2006, chapter 7) is checked over all candidates. A budget instead of a number is the
same problem in v_i = cost_i w_i (`oed.design.rules`).

Candidates that no optimal plan can want are eliminated for good: a plan w' that carries
weight on i has a value of at most the line's bound with that weight forced, so where
even that lies below a value reached, i is out.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.design.blocks import as_blocks
from oed.design.certificate import SAFE, carried
from oed.design.criterion import Criterion, Determinant
from oed.design.objective import Objective, Plain, Tangent

#: rounds of adding candidates; Newton steps in each
ROUNDS, STEPS = 200, 8
#: rounds after which Newton's steps are given up where the slopes are still worse than
#: those they started from
HOPELESS = 4
#: damping of Newton's step, as a share of the mean curvature: more where the step does
#: not raise the value
DAMPING = (1e-10, 1e-6, 1e-3, 1e-1, 1e1)
#: change in log phi below which a round counts as none
STILL = 1e-11
#: candidates in the first active set, at the least and a direction
START, START_PER_DIRECTION = 60, 6
#: multiplicative steps before Newton's; where they are all there is, and the gap that
#: then is enough
MULTIPLICATIVE, MULTIPLIED, ENOUGH = 16, 300, 1e-2
#: candidates beyond which the start is sought in a sample of them
SAMPLE = 20000


@dataclasses.dataclass(frozen=True)
class Relaxed:
    """Optimal weights.

    weights  (C,) sum N;  value log phi at them;  bound a valid upper bound of every
             feasible plan's log phi
    slopes   (C,) d log phi / dw_i at the optimum: the larger, the more a candidate is
             wanted
    gap      bound - value: what the certificate knows the bound to be loose by, as a
             relaxation
    """

    weights: Array
    value: float
    bound: float
    slopes: Array

    @property
    def gap(self) -> float:
        """bound - value."""
        return self.bound - self.value


def relax(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-8,
    criterion: Criterion | None = None,
) -> Relaxed:
    """Relaxed weights of candidates (C, n) or (C, k, n) for a concave criterion (D
    unless told).

    `tolerance` is the gap sought in log phi. Criteria that are not smooth are
    approached over their ladder. Raises ValueError where the caps cannot carry `size`,
    or where candidates and prior leave directions unseen.
    """
    blocks = as_blocks(rows)
    n = blocks.shape[2]
    base = np.zeros((n, n)) if prior is None else prior
    wanted = Determinant(n) if criterion is None else criterion
    if not wanted.concave:
        raise ValueError(
            f"{wanted.name} is not concave: see oed.design.condition for its bound"
        )
    ladder = [c for c in wanted.ladder() if c.smooth]
    start: Array | None = None
    for rung in ladder[:-1]:
        start = solve(Plain(rung, blocks, base), size, cap, 1e-3, start).weights
    found = solve(Plain(ladder[-1], blocks, base), size, cap, tolerance, start)
    if not wanted.smooth:
        active = np.flatnonzero(found.weights > 0)
        value = Plain(wanted, blocks, base).value(active, found.weights[active])
        found = dataclasses.replace(found, value=value)
    return found


def solve(
    objective: Objective,
    size: float,
    cap: Array | float = 1.0,
    tolerance: float = 1e-8,
    start: Array | None = None,
) -> Relaxed:
    """Optimal weights of an objective; `start` (C,) are weights to begin with."""
    count = objective.count
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    if caps.sum() < size * (1 - 1e-12):
        raise ValueError(
            f"{count} candidates of at most {np.max(cap):g} each cannot carry a weight"
            f" of {size:g}"
        )
    same: Array | float = float(caps[0]) if np.ptp(caps) == 0.0 else caps
    bound, line, most = np.inf, None, 2 * objective.directions
    if start is None:
        active, weights, bound = _begin(objective, size, caps)
    else:
        active, weights = _resume(start, size, caps)
    reached, last, still, before = -np.inf, np.inf, 0, bound
    for k in range(ROUNDS):
        weights = _newton(objective, active, weights, caps[active])
        line = objective.line(active, weights)
        here = line.bound(carried(line.slopes, size, same) * (1.0 + 1e-13)) + SAFE
        bound = min(bound, here)
        if bound - line.value < tolerance:
            break
        if k == HOPELESS and here > before + 1.0:
            return _multiplied(objective, size, caps, tolerance)
        # a smoothed maximum leaves a gap of its own: where neither value nor bound
        # moves, that is all there is
        still = (
            still + 1 if line.value - reached < STILL and last - bound < STILL else 0
        )
        if still == 3:
            break
        reached, last = max(reached, line.value), bound
        active, weights = _joined(active, weights, line.slopes, caps, most)
    assert line is not None
    full = np.zeros(count)
    full[active] = weights
    return Relaxed(full, line.value, bound, line.slopes)


def _multiplied(
    objective: Objective, size: float, caps: Array, tolerance: float
) -> Relaxed:
    """Weights by multiplicative steps alone.

    Where every set-up brings unknowns of its own, the least weight on it resolves them,
    and weights far below a reading are part of the optimum: Newton's model is no good
    there, and leaving small weights out is worse.
    """
    count = objective.count
    everyone, weights, bound = np.arange(count), np.full(count, size / count), np.inf
    best: tuple[Array, Tangent] | None = None
    for _ in range(MULTIPLIED):
        line = objective.line(everyone, weights)
        bound = min(bound, line.bound(carried(line.slopes, size, caps)) + SAFE)
        if best is None or line.value > best[1].value:
            best = weights, line
        if bound - best[1].value < max(tolerance, ENOUGH):
            break
        weights = _feasible(weights * np.sqrt(line.slopes), size, caps)
    assert best is not None
    return Relaxed(best[0], best[1].value, bound, best[1].slopes)


def eliminated(line: Tangent, bound_of: float, size: float, caps: Array) -> Index:
    """Candidates (indices) that no plan with a value of at least `bound_of` can hold at
    their full cap.

    A plan that holds i gives up, against what the line carries at best, the last weight
    of the multiplier's candidate in exchange for i's slope.
    """
    order = np.argsort(-line.slopes, kind="stable")
    filled = np.cumsum(caps[order])
    last = order[min(int(np.searchsorted(filled, size)), len(order) - 1)]
    level = line.slopes[last]
    best = carried(line.slopes, size, caps)
    loss = np.maximum(level - line.slopes, 0.0) * caps
    told = (
        np.array([line.bound(best - x) for x in loss])
        if line.straight
        else _bounds(line, best - loss)
    )
    return np.flatnonzero(told + SAFE < bound_of)


def _bounds(line: Tangent, reached: Array) -> Array:
    return np.asarray(line.offset + np.log(np.maximum(line.held + reached, 1e-300)))


def _begin(
    objective: Objective, size: float, caps: Array
) -> tuple[Index, Array, float]:
    """A first active set with feasible weights, from a few multiplicative steps on (a
    sample of) the candidates; and the bound seen on the way, where it was over all of
    them.
    """
    count = objective.count
    chosen = np.arange(0, count, max(1, count // SAMPLE))
    weights = np.full(len(chosen), size / len(chosen))
    some = objective.sample(chosen)
    some = some.ridged(1e-9 * some.typical(weights))
    everyone, bound = np.arange(len(chosen)), np.inf
    for _ in range(MULTIPLICATIVE):
        line = some.line(everyone, weights)
        if len(chosen) == count:
            bound = min(bound, line.bound(carried(line.slopes, size, caps)) + SAFE)
        # the exponent 1/2 never lowers D, A, c and I (Silvey, Titterington and Torsney
        # 1978; Yu 2010)
        weights = weights * np.sqrt(line.slopes)
        weights *= size / weights.sum()
    # an optimal design needs no more than n (n + 1) / 2 points, and mostly about twice
    # n
    wanted = max(
        START,
        START_PER_DIRECTION * objective.directions,
        int(np.ceil(2 * size / caps.mean())),
    )
    best = np.argsort(-weights, kind="stable")[:wanted]
    while caps[chosen[best]].sum() < size:
        wanted *= 2
        if wanted >= 2 * len(chosen):
            return (
                np.arange(count),
                _feasible(np.full(count, size / count), size, caps),
                bound,
            )
        best = np.argsort(-weights, kind="stable")[:wanted]
    return chosen[best], _feasible(weights[best], size, caps[chosen[best]]), bound


def _resume(start: Array, size: float, caps: Array) -> tuple[Index, Array]:
    active = np.flatnonzero(start > 0)
    return active, _feasible(start[active], size, caps[active])


def _feasible(weights: Array, size: float, caps: Array) -> Array:
    """Weights scaled to the sum `size`, what exceeds the caps handed on to the others."""
    weights = np.maximum(weights, 1e-12)
    for _ in range(100):
        full = weights >= caps
        left = size - caps[full].sum()
        rest = weights[~full].sum()
        weights = np.where(full, caps, weights * (left / rest if rest > 0 else 1.0))
        if not (weights > caps * (1 + 1e-15)).any():
            break
    return np.minimum(weights, caps)


def _newton(objective: Objective, active: Index, weights: Array, caps: Array) -> Array:
    """Newton steps over the free weights of the active set, each followed by a check
    that the value grew.
    """
    for _ in range(STEPS):
        # a weight within rounding of a bound would stop every step at once
        weights = np.where(
            weights < 1e-13 * caps,
            0.0,
            np.where(weights > caps * (1.0 - 1e-13), caps, weights),
        )
        moved = _moved(objective, active, weights, caps)
        if moved is None:
            break
        weights = moved
    return weights


def _moved(
    objective: Objective, active: Index, weights: Array, caps: Array
) -> Array | None:
    """Weights after one step that raises the value: bent at the bounds, so that many
    weights can reach them at once, with more damping where the step is too long; else
    straight to the first bound, or from one weight to another.
    """
    slopes, curvature = objective.newton(active, weights)
    value = objective.value(active, weights)
    longest: tuple[Array, Index] | None = None
    for damp in DAMPING:
        step, free = _direction(slopes, curvature, weights, caps, damp)
        if not free.size:
            break
        longest = longest or (step, free)
        bent = weights.copy()
        bent[free] = _projected(
            weights[free] + step, float(weights[free].sum()), caps[free]
        )
        if objective.value(active, bent) > value:
            return bent
    # last: it lets go of one weight at a time, and wide blocks have hundreds to let go
    straight = (
        None
        if longest is None
        else _straight(objective, active, weights, *longest, caps)
    )
    if straight is not None:
        return straight
    step, free = _exchanged(slopes, curvature, weights, caps)
    return (
        None
        if not free.size
        else _straight(objective, active, weights, step, free, caps)
    )


def _direction(
    slopes: Array, curvature: Array, weights: Array, caps: Array, damp: float
) -> tuple[Array, Index]:
    """Newton step over the weights that are free, or want to leave their bound; it
    keeps their sum.
    """
    inside = (weights > 0) & (weights < caps)
    level = (
        float(np.average(slopes, weights=np.where(inside, weights, 0.0)))
        if inside.any()
        else float(slopes.mean())
    )
    free = np.flatnonzero(
        inside
        | ((weights <= 0) & (slopes > level))
        | ((weights >= caps) & (slopes < level))
    )
    while free.size > 1:
        hessian = curvature[np.ix_(free, free)]
        # more free weights than distinct information: the ridge picks the shortest of
        # the equal steps
        hessian[np.diag_indices_from(hessian)] += (
            damp * np.trace(hessian) / len(free) + 1e-300
        )
        solved = np.linalg.solve(
            hessian, np.column_stack([slopes[free], np.ones(len(free))])
        )
        step = solved[:, 0] - solved[:, 0].sum() / solved[:, 1].sum() * solved[:, 1]
        outward = ((weights[free] <= 0) & (step < 0)) | (
            (weights[free] >= caps[free]) & (step > 0)
        )
        if not outward.any():
            return step, free
        free = free[~outward]
    return np.zeros(0), free[:0]


def _exchanged(
    slopes: Array, curvature: Array, weights: Array, caps: Array
) -> tuple[Array, Index]:
    """Newton step from the least wanted weight to the most wanted one: where the face
    itself is in the way.
    """
    giver = int(np.argmin(np.where(weights > 0, slopes, np.inf)))
    taker = int(np.argmax(np.where(weights < caps, slopes, -np.inf)))
    gain = slopes[taker] - slopes[giver]
    if not gain > 1e-12 * abs(slopes[taker]):
        return np.zeros(0), np.zeros(0, dtype=np.intp)
    pair = np.array([taker, giver])
    bend = float(
        np.array([1.0, -1.0]) @ curvature[np.ix_(pair, pair)] @ np.array([1.0, -1.0])
    )
    step = min(
        gain / max(bend, 1e-300),
        float(caps[taker] - weights[taker]),
        float(weights[giver]),
    )
    return np.array([step, -step]), pair


def _straight(
    objective: Objective,
    active: Index,
    weights: Array,
    step: Array,
    free: Index,
    caps: Array,
) -> Array | None:
    """Weights after the longest share of a step that stays feasible and raises the
    value; None where none does.
    """
    here, value = weights[free], objective.value(active, weights)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(
            step < 0,
            here / -step,
            np.where(step > 0, (caps[free] - here) / step, np.inf),
        )
    share = min(1.0, float(room.min()))
    if share < 1e-6:
        return None
    for _ in range(20):
        trial = weights.copy()
        trial[free] = np.clip(here + share * step, 0.0, caps[free])
        if objective.value(active, trial) > value:
            return trial
        share *= 0.5
    return None


def _projected(wanted: Array, total: float, caps: Array) -> Array:
    """The nearest weights within 0 and the caps that have the sum `total`."""
    low, high = float((wanted - caps).min()), float(wanted.max())
    for _ in range(60):
        shift = 0.5 * (low + high)
        if np.clip(wanted - shift, 0.0, caps).sum() > total:
            low = shift
        else:
            high = shift
    kept = np.clip(wanted - high, 0.0, caps)
    inside = (kept > 0) & (kept < caps)
    if inside.any():
        kept[inside] += (total - kept.sum()) / inside.sum()
    return np.asarray(np.clip(kept, 0.0, caps))


def _joined(
    active: Index, weights: Array, slopes: Array, caps: Array, most: int
) -> tuple[Index, Array]:
    """The active set less its zero weights, plus the candidates outside that are wanted
    most.
    """
    keep = weights > 0
    active, weights = active[keep], weights[keep]
    inside = weights < caps[active]
    level = (
        float(np.average(slopes[active][inside], weights=weights[inside]))
        if inside.any()
        else 0.0
    )
    outside = np.ones(len(slopes), dtype=bool)
    outside[active] = False
    wanted = np.flatnonzero(outside & (slopes > level))
    wanted = wanted[np.argsort(-slopes[wanted], kind="stable")[:most]]
    return np.concatenate([active, wanted]), np.concatenate(
        [weights, np.zeros(len(wanted))]
    )
