"""Optimal weights: the convex relaxation of the choice, with its certificate.

    maximise  log phi(M0 + sum_i w_i X_i^T X_i)   over  0 <= w_i <= cap_i,  sum_i w_i = N.

Every plan of N candidates is feasible (cap 1: no repeats; cap inf: repeats allowed), so
the optimum bounds it. The method is an active set of candidates: Newton steps, with the
criterion's own curvature, in the face of the free weights (`oed.design.newton`).
Candidates whose slope exceeds the multiplier join, and weights that reach a bound
leave. Where Newton steps end, the equivalence theorem (Kiefer and Wolfowitz 1960;
Pukelsheim 2006, chapter 7) is checked over all candidates. A budget instead of a number
is the same problem in v_i = cost_i w_i (`oed.design.rules`).

Candidates that no optimal plan can hold are eliminated for good. A plan w' with weight
on i has a value of at most the line's bound with that weight forced. Where even this
bound is below a value already reached, i cannot be in an optimal plan.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import as_blocks, information
from oed.design.certificate import ROUNDING, knapsack_value
from oed.design.forms import Criterion, Determinant
from oed.design.forms.determinant import log_det_of_gram
from oed.design.newton import newton_steps, scale_to_size
from oed.design.objective import CriterionObjective, Objective, Tangent
from oed.design.whitening import EXACT, Rounding, gamma, is_ill_conditioned, whiten

#: rounds of adding candidates
ROUNDS = 200
#: round after which Newton steps are given up if the bound is worse than at the start
NEWTON_PATIENCE = 4
#: change in log phi below which a round counts as none; such rounds that end the method
STAGNATION, STAGNANT_ROUNDS = 1e-11, 3
#: candidates in the first active set, at the least and a direction
START, START_PER_DIRECTION = 60, 6
#: multiplicative steps before Newton steps
MULTIPLICATIVE_START = 16
#: multiplicative steps where Newton steps fail, and the duality gap that is then enough
MULTIPLICATIVE_ONLY, MULTIPLICATIVE_GAP = 300, 1e-2
#: candidates beyond which the start is sought in a sample of them
SAMPLE = 20000


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """Optimal weights.

    weights  (C,) with sum N
    value    log phi at the weights
    bound    upper bound of every feasible plan's log phi
    slopes   (C,) d log phi / dw_i at the optimum: how much a candidate is wanted
    """

    weights: Array
    value: float
    bound: float
    slopes: Array

    @property
    def duality_gap(self) -> float:
        """bound - value: how much too high the bound can be, as a relaxation."""
        return self.bound - self.value


def relax(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-8,
    criterion: Criterion | None = None,
    rounding: Rounding = EXACT,
) -> Relaxation:
    """Optimal weights of candidates for a concave criterion.

    rows       (C, n) or (C, k, n)
    size       sum of the weights
    prior      (n, n) prior information
    cap        largest weight, (C,) or one number
    tolerance  duality gap to reach, in log phi
    criterion  D by default; one that is not smooth is approached by its continuation
    rounding   of rows and prior information

    Raises ValueError where the caps cannot carry `size`, or where candidates and prior
    leave directions undetermined.
    """
    blocks = as_blocks(rows)
    n = blocks.shape[2]
    base = np.zeros((n, n)) if prior is None else prior
    goal = Determinant(n) if criterion is None else criterion
    if not goal.concave:
        raise ValueError(
            f"{goal.name} is not concave: see oed.design.condition for its bound"
        )
    if goal.any_coordinates:
        return _relax_determinant(blocks, size, base, cap, tolerance, rounding)
    smooth = [c for c in goal.continuation() if c.smooth]
    start: Array | None = None
    for level in smooth[:-1]:
        objective = CriterionObjective(level, blocks, base)
        start = solve(objective, size, cap, 1e-3, start).weights
    last = CriterionObjective(smooth[-1], blocks, base, rounding)
    optimum = solve(last, size, cap, tolerance, start)
    if goal.smooth:
        return optimum
    active = np.flatnonzero(optimum.weights > 0)
    exact = CriterionObjective(goal, blocks, base)
    value = exact.value(active, optimum.weights[active])
    return dataclasses.replace(optimum, value=value)


def _relax_determinant(
    blocks: Array,
    size: float,
    base: Array,
    cap: Array | float,
    tolerance: float,
    rounding: Rounding,
) -> Relaxation:
    """Optimal weights for D, in coordinates where the candidates are well conditioned.

    The determinant changes by that of the coordinates.
    """
    n, shift = blocks.shape[2], 0.0
    if is_ill_conditioned(base + information(blocks)):
        white = whiten(blocks, base if base.any() else None, 0.0)
        if white.basis.shape[1] == n:
            blocks, base = white.blocks, white.prior
            shift = -log_det_of_gram(white.basis) / n
            rounding = rounding.in_basis(white.basis).plus(white.rounding)
    objective = CriterionObjective(Determinant(n), blocks, base, rounding)
    optimum = solve(objective, size, cap, tolerance)
    return dataclasses.replace(
        optimum, value=optimum.value + shift, bound=optimum.bound + shift
    )


def solve(
    objective: Objective,
    size: float,
    cap: Array | float = 1.0,
    tolerance: float = 1e-8,
    start: Array | None = None,
) -> Relaxation:
    """Optimal weights of an objective; `start` (C,) are weights to begin with."""
    count = objective.count
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    check_caps(caps, size, cap)
    common_cap: Array | float = float(caps[0]) if np.ptp(caps) == 0.0 else caps
    if start is None:
        active, weights, bound = _begin(objective, size, caps)
    else:
        bound = np.inf
        active = np.flatnonzero(start > 0)
        weights = scale_to_size(start[active], size, caps[active])
    first_bound, best_value, last_bound, stagnant = bound, -np.inf, np.inf, 0
    for k in range(ROUNDS):
        weights = newton_steps(objective, active, weights, caps[active])
        tangent = objective.tangent(active, weights)
        bound_here = bound_by(tangent, size, common_cap)
        bound = min(bound, bound_here)
        if bound - tangent.value < tolerance:
            break
        if k == NEWTON_PATIENCE and bound_here > first_bound + 1.0:
            return _multiplicative_steps(objective, size, caps, tolerance)
        # a smoothed maximum has a gap of its own: stop where neither value nor bound
        # moves
        value_stalls = tangent.value - best_value < STAGNATION
        bound_stalls = last_bound - bound < STAGNATION
        stagnant = stagnant + 1 if value_stalls and bound_stalls else 0
        if stagnant == STAGNANT_ROUNDS:
            break
        best_value, last_bound = max(best_value, tangent.value), bound
        active, weights = _update_active_set(
            active, weights, tangent.slopes, caps, 2 * objective.directions
        )
    all_weights = np.zeros(count)
    all_weights[active] = weights
    return Relaxation(all_weights, tangent.value, bound, tangent.slopes)


def bound_by(tangent: Tangent, size: float, cap: Array | float) -> float:
    """The bound of all plans that a line gives, rounded up."""
    carried = knapsack_value(tangent.slopes, size, cap) + size * tangent.rounding
    return tangent.bound(carried * (1.0 + gamma(len(tangent.slopes)))) + ROUNDING


def check_caps(caps: Array, size: float, cap: Array | float) -> None:
    """Raises ValueError where the caps (C,) cannot carry the size."""
    if caps.sum() < size * (1 - 1e-12):
        raise ValueError(
            f"{len(caps)} candidates of at most {np.max(cap):g} each cannot carry a"
            f" weight of {size:g}"
        )


def _multiplicative_steps(
    objective: Objective, size: float, caps: Array, tolerance: float
) -> Relaxation:
    """Weights by multiplicative steps alone.

    Where every set-up brings unknowns of its own, the least weight on it determines
    them, and weights far below one reading belong to the optimum. Newton's model fails
    there, and leaving small weights out is worse.
    """
    count = objective.count
    everything = np.arange(count)
    weights = np.full(count, size / count)
    tangent = objective.tangent(everything, weights)
    bound = bound_by(tangent, size, caps)
    best_weights, best_tangent = weights, tangent
    for _ in range(1, MULTIPLICATIVE_ONLY):
        if bound - best_tangent.value < max(tolerance, MULTIPLICATIVE_GAP):
            break
        weights = scale_to_size(weights * np.sqrt(tangent.slopes), size, caps)
        tangent = objective.tangent(everything, weights)
        bound = min(bound, bound_by(tangent, size, caps))
        if tangent.value > best_tangent.value:
            best_weights, best_tangent = weights, tangent
    return Relaxation(best_weights, best_tangent.value, bound, best_tangent.slopes)


def eliminate(tangent: Tangent, value: float, size: float, caps: Array) -> Index:
    """Candidates that no plan with at least this value holds at their full cap.

    A plan that holds i loses, against what the line carries at best, the last weight of
    the multiplier's candidate in exchange for i's slope.
    """
    order = np.argsort(-tangent.slopes, kind="stable")
    carried = np.cumsum(caps[order])
    last_place = min(int(np.searchsorted(carried, size)), len(order) - 1)
    multiplier = tangent.slopes[order[last_place]]
    best = knapsack_value(tangent.slopes, size, caps) + size * tangent.rounding
    loss = np.maximum(multiplier - tangent.slopes, 0.0) * caps
    if tangent.linear:
        bounds = np.array([tangent.bound(best - x) for x in loss])
    else:
        heights = np.maximum(tangent.base_term + (best - loss), 1e-300)
        bounds = tangent.offset + np.log(heights)
    return np.flatnonzero(bounds + ROUNDING < value)


# -- the active set --------------------------------------------------------------------


def _begin(
    objective: Objective, size: float, caps: Array
) -> tuple[Index, Array, float]:
    """A first active set with feasible weights, and a bound.

    A few multiplicative steps are taken on the candidates, or on a sample of them. The
    bound is finite only where the steps run over all candidates.
    """
    count = objective.count
    sample = np.arange(0, count, max(1, count // SAMPLE))
    weights = np.full(len(sample), size / len(sample))
    part = objective.subset(sample)
    part = part.regularised(weights)
    everything, bound = np.arange(len(sample)), np.inf
    for _ in range(MULTIPLICATIVE_START):
        tangent = part.tangent(everything, weights)
        if len(sample) == count:
            bound = min(bound, bound_by(tangent, size, caps))
        # the exponent 1/2 never lowers D, A, c and I (Silvey, Titterington and Torsney
        # 1978; Yu 2010)
        weights = weights * np.sqrt(tangent.slopes)
        weights *= size / weights.sum()
    # an optimal design needs no more than n (n + 1) / 2 points, and mostly about 2 n
    by_directions = START_PER_DIRECTION * objective.directions
    by_size = int(np.ceil(2 * size / caps.mean()))
    places = max(START, by_directions, by_size)
    best = np.argsort(-weights, kind="stable")[:places]
    while caps[sample[best]].sum() < size:
        places *= 2
        if places >= 2 * len(sample):
            equal = np.full(count, size / count)
            return np.arange(count), scale_to_size(equal, size, caps), bound
        best = np.argsort(-weights, kind="stable")[:places]
    active = sample[best]
    return active, scale_to_size(weights[best], size, caps[active]), bound


def _update_active_set(
    active: Index, weights: Array, slopes: Array, caps: Array, most: int
) -> tuple[Index, Array]:
    """The active set without zero weights, with the steepest candidates outside it."""
    positive = weights > 0
    active, weights = active[positive], weights[positive]
    inside = weights < caps[active]
    multiplier = 0.0
    if inside.any():
        inner_slopes = slopes[active][inside]
        multiplier = float(np.average(inner_slopes, weights=weights[inside]))
    outside = np.ones(len(slopes), dtype=bool)
    outside[active] = False
    joining = np.flatnonzero(outside & (slopes > multiplier))
    joining = joining[np.argsort(-slopes[joining], kind="stable")[:most]]
    weights = np.concatenate([weights, np.zeros(len(joining))])
    return np.concatenate([active, joining]), weights
