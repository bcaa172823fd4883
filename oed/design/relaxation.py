"""Optimal weights: the convex relaxation of the choice, with its certificate.

    maximise  log phi(M0 + sum_i w_i X_i^T X_i)   over  0 <= w_i <= cap_i,  sum_i w_i = N.

Every plan of N candidates is feasible (cap 1: no repeats; cap inf: repeats allowed), so
the optimum bounds it. The method is an active set of candidates: Newton steps, with the
criterion's own curvature, in the face of the free weights.
Candidates whose slope exceeds the multiplier join, and weights that reach a bound
leave. Where Newton steps end, the equivalence theorem (Kiefer and Wolfowitz 1960;
Pukelsheim 2006, chapter 7) is checked over all candidates. A budget instead of a number
is the same problem in v_i = cost_i w_i (`oed.design.rules`).

Candidates that no optimal plan can hold are eliminated for good. A plan w' with weight
on i has a value of at most the line's bound with that weight forced. Where even this
bound is below a value already reached, i cannot be in an optimal plan.

A weight at a bound that wants to leave it is free. A Newton step is bent at the bounds, so
that many weights can reach them at once, with more damping where the step is too long.
Where no such step raises the value, it goes straight to the first bound, or shifts
weight from the least wanted candidate to the most wanted one.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import (
    block_array,
    gamma,
    information,
    is_ill_conditioned,
    whiten,
)
from oed.design.forms import Criterion, Determinant
from oed.design.forms.determinant import log_det_of_gram
from oed.design.objective import (
    LOG_ROUNDING,
    CriterionObjective,
    Objective,
    Tangent,
    knapsack_value,
)

MAX_NEWTON_STEPS = 8  #: Newton steps in a call, at the most
#: damping of a step, as a share of the mean curvature: more where the step does not
#: raise the value
DAMPING_FACTORS = (1e-10, 1e-6, 1e-3, 1e-1, 1e1)
BOUND_TOLERANCE = 1e-13  #: a weight within this share of a bound is put on the bound
MAX_HALVINGS = 20  #: number of halvings of a straight step
MIN_STEP_SHARE = 1e-6  #: least share of a straight step that is tried: 2^-20
#: rounding of a value, over the value: two units in its last place
VALUE_ROUNDING = 4.4e-16


def newton_steps(
    objective: Objective, active: Index, weights: Array, caps: Array
) -> Array:
    """Weights (A,) after Newton steps; each step raises the value."""
    for _ in range(MAX_NEWTON_STEPS):
        # a weight within rounding of a bound would stop every step at once
        capped = np.where(weights > caps * (1.0 - BOUND_TOLERANCE), caps, weights)
        weights = np.where(weights < BOUND_TOLERANCE * caps, 0.0, capped)
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
    gradient, curvature = objective.derivatives(active, weights)
    value = objective.value(active, weights)

    def is_better(trial: Array) -> bool:
        # concave, it stays below its tangent: rounding is no rise
        rise = float(gradient @ (trial - weights))
        rounded = rise <= VALUE_ROUNDING * max(1.0, abs(value))
        return not rounded and objective.value(active, trial) > value

    longest: tuple[Array, Index] | None = None
    for damping in DAMPING_FACTORS:
        step, free = _newton_direction(gradient, curvature, weights, caps, damping)
        if not free.size:
            break
        longest = longest or (step, free)
        total = float(weights[free].sum())
        bent = weights.copy()
        bent[free] = project_to_sum(weights[free] + step, total, caps[free])
        if is_better(bent):
            return bent
    # last: it releases one weight at a time, and wide blocks have hundreds to release
    if longest is not None:
        straight = _straight_step(is_better, weights, *longest, caps)
        if straight is not None:
            return straight
    step, free = _pair_direction(gradient, curvature, weights, caps)
    if not free.size:
        return None
    return _straight_step(is_better, weights, step, free, caps)


def _newton_direction(
    gradient: Array, curvature: Array, weights: Array, caps: Array, damping: float
) -> tuple[Array, Index]:
    """Newton step over the free weights that preserves their sum, and these weights."""
    free = _free_weights(gradient, weights, caps)
    while free.size > 1:
        hessian = curvature[np.ix_(free, free)]
        # more free weights than distinct information: the ridge picks the shortest of
        # the equal steps
        ridge = damping * np.trace(hessian) / len(free) + 1e-300
        hessian[np.diag_indices_from(hessian)] += ridge
        right = np.column_stack([gradient[free], np.ones(len(free))])
        by_gradient, by_ones = np.linalg.solve(hessian, right).T
        step = by_gradient - by_gradient.sum() / by_ones.sum() * by_ones
        below = (weights[free] <= 0) & (step < 0)
        above = (weights[free] >= caps[free]) & (step > 0)
        outward = below | above
        if not outward.any():
            return step, free
        free = free[~outward]
    return np.zeros(0), free[:0]


def _free_weights(gradient: Array, weights: Array, caps: Array) -> Index:
    """Weights inside their bounds, and those that want to leave a bound."""
    inside = (weights > 0) & (weights < caps)
    if inside.any():
        inner_weights = np.where(inside, weights, 0.0)
        multiplier = float(np.average(gradient, weights=inner_weights))
    else:
        multiplier = float(gradient.mean())
    leaves_zero = (weights <= 0) & (gradient > multiplier)
    leaves_cap = (weights >= caps) & (gradient < multiplier)
    return np.flatnonzero(inside | leaves_zero | leaves_cap)


def _pair_direction(
    gradient: Array, curvature: Array, weights: Array, caps: Array
) -> tuple[Array, Index]:
    """Newton step from the least wanted weight to the most wanted one."""
    giver = int(np.argmin(np.where(weights > 0, gradient, np.inf)))
    taker = int(np.argmax(np.where(weights < caps, gradient, -np.inf)))
    gain = gradient[taker] - gradient[giver]
    if not gain > 1e-12 * abs(gradient[taker]):
        return np.zeros(0), np.zeros(0, dtype=np.intp)
    pair = np.array([taker, giver])
    direction = np.array([1.0, -1.0])
    bend = float(direction @ curvature[np.ix_(pair, pair)] @ direction)
    room = min(float(caps[taker] - weights[taker]), float(weights[giver]))
    step = min(gain / max(bend, 1e-300), room)
    return np.array([step, -step]), pair


def _straight_step(
    is_better: Callable[[Array], bool],
    weights: Array,
    step: Array,
    free: Index,
    caps: Array,
) -> Array | None:
    """Weights after the longest feasible share of a step that raises the value."""
    start = weights[free]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_cap = np.where(step > 0, (caps[free] - start) / step, np.inf)
        room = np.where(step < 0, start / -step, to_cap)
    share = min(1.0, float(room.min()))
    if share < MIN_STEP_SHARE:
        return None
    for _ in range(MAX_HALVINGS):
        trial = weights.copy()
        trial[free] = np.clip(start + share * step, 0.0, caps[free])
        if is_better(trial):
            return trial
        share *= 0.5
    return None


def project_to_sum(target: Array, total: float, caps: Array) -> Array:
    """The nearest weights within 0 and the caps that have the sum `total`."""
    shift = _shift_to_sum(target, total, caps)
    projected = np.minimum(np.maximum(target - shift, 0.0), caps)
    inside = (projected > 0) & (projected < caps)
    if inside.any():
        projected[inside] += (total - projected.sum()) / inside.sum()
    return np.minimum(np.maximum(projected, 0.0), caps)


def _shift_to_sum(target: Array, total: float, caps: Array) -> float:
    """The number to subtract from all weights for the sum `total` within 0 and the
    caps, by its sum, piecewise linear in it.
    """
    bends = np.concatenate([target - caps, target])
    order = np.argsort(bends)
    bends = bends[order]
    inside = np.cumsum(np.where(order < len(target), 1.0, -1.0))
    drops = inside[:-1] * np.diff(bends)
    sums = caps.sum() - np.append(0.0, np.cumsum(drops))
    last = max(int(np.count_nonzero(sums > total)) - 1, 0)
    excess = sums[last] - total
    return float(bends[last] + excess / max(inside[last], 1.0))


MAX_ROUNDS = 200  #: rounds of adding candidates
#: change in log phi below which a round counts as none: the rounding of its sums
STAGNATION_GAIN = 1e-11
#: number of such rounds that end the method: one alone may only exchange candidates
MAX_STAGNANT_ROUNDS = 3
START_SIZE = 60  #: number of candidates in the first active set, at the least
#: the same for each direction: an optimal design mostly needs about two
START_PER_DIRECTION = 6
START_STEPS = 16  #: multiplicative steps before Newton steps
SAMPLE_SIZE = 20000  #: candidates beyond which the start is sought in a sample of them
#: seed of the candidates that join the first active set whatever their weight
SAMPLE_SEED = 20260101


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """Optimal weights."""

    weights: Array  #: (C,) with sum N
    value: float  #: log phi at the weights
    bound: float  #: upper bound of every feasible plan's log phi
    #: (C,) d log phi / dw_i at the optimum: how much a candidate is wanted
    gradient: Array

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
) -> Relaxation:
    """Optimal weights of candidates for a concave criterion.

    rows       (C, n) or (C, k, n)
    size       sum of the weights
    prior      (n, n) prior information
    cap        largest weight, (C,) or one number
    tolerance  duality gap to reach, in log phi
    criterion  D by default; one that is not smooth is approached by its continuation

    Raises ValueError where the caps cannot carry `size`, or where candidates and prior
    leave directions undetermined.
    """
    blocks = block_array(rows)
    n = blocks.shape[2]
    base = np.zeros((n, n)) if prior is None else prior
    goal = Determinant(n) if criterion is None else criterion
    return relax_objective(CriterionObjective(goal, blocks, base), size, cap, tolerance)


def relax_objective(
    objective: CriterionObjective,
    size: float,
    cap: Array | float = 1.0,
    tolerance: float = 1e-8,
) -> Relaxation:
    """As `relax`, for a criterion of candidates and prior information."""
    goal = objective.criterion
    if not goal.concave:
        raise ValueError(
            f"{goal.name} is not concave: see oed.design.condition for its bound"
        )
    if goal.any_coordinates:
        return _relax_determinant(objective, size, cap, tolerance)
    smooth = [
        dataclasses.replace(objective, criterion=level)
        for level in goal.continuation()
        if level.smooth
    ]
    start: Array | None = None
    for level in smooth[:-1]:
        start = solve(level, size, cap, 1e-3, start).weights
    optimum = solve(smooth[-1], size, cap, tolerance, start)
    if goal.smooth:
        return optimum
    active = np.flatnonzero(optimum.weights > 0)
    value = objective.value(active, optimum.weights[active])
    return dataclasses.replace(optimum, value=value)


def _relax_determinant(
    objective: CriterionObjective, size: float, cap: Array | float, tolerance: float
) -> Relaxation:
    """Optimal weights for D, in coordinates where candidates are well conditioned."""
    n = objective.directions
    blocks, base, rounding = objective.blocks, objective.base, objective.rounding
    shift = 0.0
    if is_ill_conditioned(base + information(blocks)):
        white = whiten(blocks, base if base.any() else None, 0.0)
        if white.basis.shape[1] == n:
            blocks, base = white.blocks, white.prior
            shift = -log_det_of_gram(white.basis) / n
            rounding = rounding.rounding_of_basis(white.basis).plus(white.rounding)
    white_objective = CriterionObjective(Determinant(n), blocks, base, rounding)
    optimum = solve(white_objective, size, cap, tolerance)
    return dataclasses.replace(
        optimum, value=optimum.value + shift, bound=optimum.bound + shift
    )


SCALING_GAP = 1e-2  #: duality gap of weights that only scale a problem


def determined_start(
    blocks: Array, base: Array, size: float, cap: Array | float
) -> Array:
    """Weights (C,) of a good plan by D, of blocks (C, k, n) and prior (n, n). Raises
    ValueError where these leave directions undetermined, whatever the columns' units.
    """
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    m = base + information(blocks, caps * (size / caps.sum()))
    scale = np.sqrt(np.diag(m))
    try:
        if not scale.all():
            raise np.linalg.LinAlgError("a column is zero")
        np.linalg.cholesky(m / np.outer(scale, scale) - 1e-14 * n * np.eye(n))
        return relax(blocks, size, base, caps, SCALING_GAP).weights
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "candidates and prior leave directions undetermined: restrict the problem"
            " to the estimable subspace"
        ) from error


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
    best_value = -np.inf
    last_bound = np.inf
    stagnant = 0
    for _ in range(MAX_ROUNDS):
        weights = newton_steps(objective, active, weights, caps[active])
        tangent = objective.tangent(active, weights)
        bound = min(bound, bound_by(tangent, size, common_cap))
        if bound - tangent.value < tolerance:
            break
        # a smoothed maximum has a gap of its own: stop where neither value nor bound
        # moves
        value_stalls = tangent.value - best_value < STAGNATION_GAIN
        bound_stalls = last_bound - bound < STAGNATION_GAIN
        stagnant = stagnant + 1 if value_stalls and bound_stalls else 0
        if stagnant == MAX_STAGNANT_ROUNDS:
            break
        best_value, last_bound = max(best_value, tangent.value), bound
        active, weights = _update_active_set(
            active, weights, tangent.gradient, caps, 2 * objective.directions
        )
    all_weights = np.zeros(count)
    all_weights[active] = weights
    return Relaxation(all_weights, tangent.value, bound, tangent.gradient)


def bound_by(tangent: Tangent, size: float, cap: Array | float) -> float:
    """The bound of all plans that a line gives, rounded up."""
    weighted = knapsack_value(tangent.gradient, size, cap) + size * tangent.rounding
    return tangent.bound(weighted * (1.0 + gamma(len(tangent.gradient)))) + LOG_ROUNDING


def check_caps(caps: Array, size: float, cap: Array | float) -> None:
    """Raises ValueError where the caps (C,) cannot carry the size."""
    if caps.sum() < size * (1 - 1e-12):
        raise ValueError(
            f"{len(caps)} candidates of at most {np.max(cap):g} each cannot carry a"
            f" weight of {size:g}"
        )


def eliminate(tangent: Tangent, value: float, size: float, caps: Array) -> Index:
    """Candidates that no plan with at least this value holds at their full cap.

    A plan that holds i loses, against what the line carries at best, the last weight of
    the multiplier's candidate in exchange for i's slope.
    """
    order = np.argsort(-tangent.gradient, kind="stable")
    filled = np.cumsum(caps[order])
    last_place = min(int(np.searchsorted(filled, size)), len(order) - 1)
    multiplier = tangent.gradient[order[last_place]]
    best = knapsack_value(tangent.gradient, size, caps) + size * tangent.rounding
    loss = np.maximum(multiplier - tangent.gradient, 0.0) * caps
    heights = np.maximum(tangent.base_term + (best - loss), 1e-300)
    bounds = tangent.offset + np.log(heights)
    return np.flatnonzero(bounds + LOG_ROUNDING < value)


# -- the active set --------------------------------------------------------------------
def _begin(
    objective: Objective, size: float, caps: Array
) -> tuple[Index, Array, float]:
    """A first active set, feasible weights, and a bound where steps run over all."""
    count = objective.count
    sample = np.arange(0, count, max(1, count // SAMPLE_SIZE))
    weights = np.full(len(sample), size / len(sample))
    part = objective.subset(sample)
    part = part.regularised(weights)
    everything = np.arange(len(sample))
    bound = np.inf
    for _ in range(START_STEPS):
        tangent = part.tangent(everything, weights)
        if len(sample) == count:
            bound = min(bound, bound_by(tangent, size, caps))
        # the exponent 1/2 never lowers D, A, c and I (Silvey, Titterington and Torsney
        # 1978; Yu 2010)
        weights = weights * np.sqrt(tangent.gradient)
        weights *= size / weights.sum()
    # an optimal design needs no more than n (n + 1) / 2 points, and mostly about 2 n
    by_directions = START_PER_DIRECTION * objective.directions
    by_size = int(np.ceil(2 * size / caps.mean()))
    places = max(START_SIZE, by_directions, by_size)
    # of many equal candidates, the first may all lie in a subspace: others join them
    order = np.argsort(-weights, kind="stable")
    mixed = np.random.default_rng(SAMPLE_SEED).permutation(len(sample))
    while places < len(sample):
        best = np.union1d(order[:places], mixed[: places // 2])
        active = sample[best]
        if caps[active].sum() >= size:
            scaled = scale_to_size(weights[best], size, caps[active])
            if np.isfinite(objective.value(active, scaled)):
                return active, scaled, bound
        places *= 2
    equal = np.full(count, size / count)
    return np.arange(count), scale_to_size(equal, size, caps), bound


def _update_active_set(
    active: Index, weights: Array, gradient: Array, caps: Array, most: int
) -> tuple[Index, Array]:
    """The active set without zero weights, with the steepest candidates outside it."""
    positive = weights > 0
    active, weights = active[positive], weights[positive]
    inside = weights < caps[active]
    multiplier = 0.0
    if inside.any():
        inner_gradient = gradient[active][inside]
        multiplier = float(np.average(inner_gradient, weights=weights[inside]))
    outside = np.ones(len(gradient), dtype=bool)
    outside[active] = False
    joining = np.flatnonzero(outside & (gradient > multiplier))
    joining = joining[np.argsort(-gradient[joining], kind="stable")[:most]]
    weights = np.concatenate([weights, np.zeros(len(joining))])
    return np.concatenate([active, joining]), weights
