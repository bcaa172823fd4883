"""F(z) = max_w l_min(M) - z l_max(M), and the least l_max / l_min, on a growing active set.

Bounds rest on dual points alone, whatever the method did. For any Y, Z positive
semidefinite of trace 1

    l_max(M) - s l_min(M) >= <Z - s Y, M>,       l_min(M) - z l_max(M) <= <Y - z Z, M>,

and their extremes over all weights are those of a fractional knapsack. So kappa^2 is at
least the least <Z, M> / <Y, M> over the weights, and F(z) is at most the largest
<Y - z Z, M>. The points are those of the path of `oed.design.interior`.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import information
from oed.design.certificate import knapsack_value
from oed.design.forms.protocol import slopes
from oed.design.interior import InteriorPath, InteriorProblem

#: rounds of joining candidates; steps of a path
ROUNDS, STEPS = 40, 60
#: candidates in the first active set, and joined in a round
START, MORE = 200, 100
#: a path ends where the active set causes less than this share of the duality gap: the
#: others are due to candidates outside
INSIDE_SHARE = 0.1
#: allowance for the rounding of traces, a share of the least eigenvalue (and of kappa)
ROUNDING = 1e-10
#: weights below this share of their cap count as none
NEGLIGIBLE = 1e-4


class DualPoint(NamedTuple):
    """Products of Y and Z with the prior information and with each candidate.

    base_low, base_high  <Y, M0>, <Z, M0>
    low, high            (C,) <Y, A_i>, <Z, A_i>
    """

    base_low: float
    base_high: float
    low: Array
    high: Array


class WeightedPlan(NamedTuple):
    """Weights (C,) with the extreme eigenvalues l_min and l_max of their information."""

    weights: Array
    least: float
    largest: float


class DualBound(NamedTuple):
    """F(z) is at most `bound` and kappa^2 at least `ratio`, by a dual point."""

    bound: float
    ratio: float
    point: DualPoint


@dataclasses.dataclass(frozen=True, eq=False)
class EigenvaluePoint:
    """Weights with their extreme eigenvalues, and the bound that a dual point implies.

    plan        weights and their eigenvalues
    dual        the bound
    slope       z; None for kappa
    profit      (C,) <Y - z Z, A_i> at the path's z
    inside_gap  duality gap over the active set alone, as a share of l_min
    total_gap   duality gap over all candidates, as a share of l_min
    """

    plan: WeightedPlan
    dual: DualBound
    slope: float | None
    profit: Array
    inside_gap: float
    total_gap: float

    @property
    def duality_gap(self) -> float:
        """Of the bound as a share of l_min, or of the ratio as a share of kappa^2."""
        if self.slope is None:
            return self.plan.largest / self.plan.least / self.dual.ratio - 1.0
        above = self.dual.bound - self.plan.least + self.slope * self.plan.largest
        return above / self.plan.least

    def log_slopes(self, share: float) -> Array:
        """(C,) d/dw of log l_min - share log l_max."""
        low = self.dual.point.low / self.plan.least
        return low - share * self.dual.point.high / self.plan.largest

    def combine(self, other: EigenvaluePoint) -> EigenvaluePoint:
        """The better weights of two points, with the better dual point of both."""
        plan, other_plan = self.plan, other.plan
        if self.slope is None:
            ratio = plan.largest / plan.least
            other_plan_better = other_plan.largest / other_plan.least < ratio
            other_dual_better = other.dual.ratio > self.dual.ratio
        else:
            value = plan.least - self.slope * plan.largest
            other_value = other_plan.least - self.slope * other_plan.largest
            other_plan_better = other_value > value
            other_dual_better = other.dual.bound < self.dual.bound
        return dataclasses.replace(
            self,
            plan=other_plan if other_plan_better else plan,
            dual=other.dual if other_dual_better else self.dual,
        )


def follow(
    problem: InteriorProblem, slope: float | None, tolerance: float
) -> EigenvaluePoint:
    """F(slope), or the least kappa without a slope.

    `tolerance` is the duality gap as a share of l_min, or of kappa^2.
    """
    if problem.caps.sum() <= problem.size * (1 + 1e-9):
        return _only_plan(problem, slope)
    active = _first_active_set(problem)
    weights = _raise_to_size(problem, problem.start[active], active)
    centre = 0.5
    best: EigenvaluePoint | None = None
    for _ in range(ROUNDS):
        known_slope = 0.0 if best is None else _slope_below(best, tolerance)
        part = problem.subset(active)
        path = InteriorPath(part, slope, weights, centre, known_slope)
        now: EigenvaluePoint | None = None
        for _ in range(STEPS):
            if not path.step():
                break
            now = _evaluate(problem, path, active)
            best = now if best is None else best.combine(now)
            if slope is None:
                path.slope = min(3.0 * path.slope, _slope_below(best, tolerance))
            converged_inside = now.inside_gap < INSIDE_SHARE * now.total_gap
            if best.duality_gap <= tolerance or converged_inside:
                break
        if now is None or best is None or best.duality_gap <= tolerance:
            break
        joining = _joining(problem, now.profit, active)
        if not joining.size:
            break
        active, weights = _update_active_set(
            problem, now.profit, path.at.w, active, joining
        )
        centre = float(np.clip(now.total_gap, 0.02, 0.3))
    if best is None:
        raise ValueError(
            "the scales of the columns differ too much for their condition number:"
            " scale them"
        )
    return best


def _slope_below(best: EigenvaluePoint, tolerance: float) -> float:
    """A slope a little below the best plan's l_min / l_max.

    At the plan's own slope, plans of any size would be equally good.
    """
    return best.plan.least / best.plan.largest * (1.0 - 0.2 * tolerance)


def _evaluate(
    problem: InteriorProblem, path: InteriorPath, active: Index
) -> EigenvaluePoint:
    """The path's weights and duals, over all candidates."""
    dual, weights = _dual_point(problem, path), path.at.w
    least, largest = problem.extreme_eigenvalues(active, weights)
    profit = dual.low - path.slope * dual.high
    base_profit = dual.base_low - path.slope * dual.base_high
    value = least - path.slope * largest
    size, caps = problem.size, problem.caps
    carried_inside = knapsack_value(profit[active], size, caps[active])
    bound = base_profit + knapsack_value(profit, size, caps)
    rounding = ROUNDING + 4e-16 * float(np.sqrt(largest / least))
    ratio = 0.0
    if path.slope_is_free:
        ratio = _least_ratio(problem, dual, largest / least) * (1.0 - rounding)
    all_weights = np.zeros(len(profit))
    all_weights[active] = weights
    return EigenvaluePoint(
        plan=WeightedPlan(all_weights, least, largest),
        dual=DualBound(bound + rounding * least, ratio, dual),
        slope=None if path.slope_is_free else path.slope,
        profit=profit,
        inside_gap=(base_profit + carried_inside - value) / least,
        total_gap=(bound - value) / least,
    )


def _dual_point(problem: InteriorProblem, path: InteriorPath) -> DualPoint:
    """The path's Y and Z at trace 1, with all candidates."""
    y = np.asarray(np.linalg.cholesky(path.at.y))
    y = y / float(np.linalg.norm(problem.turn.T @ y))
    z = np.zeros((len(path.at.y), 1))
    if path.slope:
        z = np.asarray(np.linalg.cholesky(path.at.z))
        z = z / float(np.linalg.norm(z))
    return DualPoint(
        float(np.sum((problem.white_base @ y) * y)),
        float(np.sum((problem.base @ z) * z)),
        slopes(problem.white, y),
        slopes(problem.blocks, z),
    )


def _least_ratio(problem: InteriorProblem, dual: DualPoint, ratio: float) -> float:
    """The least <Z, M> / <Y, M> over all weights.

    Dinkelbach's steps lead down from any `ratio` above it.
    """
    for _ in range(100):
        order = np.argsort(dual.high - ratio * dual.low, kind="stable")
        w = _fill_to_caps(problem.caps[order], problem.size)
        numerator = dual.base_high + dual.high[order] @ w
        denominator = dual.base_low + dual.low[order] @ w
        if numerator >= ratio * denominator * (1 - 1e-14):
            return ratio
        ratio = float(numerator / denominator)
    return 0.0


def _fill_to_caps(caps: Array, size: float) -> Array:
    """Weights that fill the caps in the given order until the size is used up."""
    return np.clip(size - (np.cumsum(caps) - caps), 0.0, caps)


def _only_plan(problem: InteriorProblem, slope: float | None) -> EigenvaluePoint:
    """The only plan, where the caps leave no choice."""
    everything = np.arange(len(problem.blocks))
    least, largest = problem.extreme_eigenvalues(everything, problem.caps)
    m = problem.base + information(problem.blocks, problem.caps)
    eigenvectors = np.linalg.eigh(m)[1]
    low = slopes(problem.blocks, eigenvectors[:, :1])
    high = slopes(problem.blocks, eigenvectors[:, -1:])
    bound = least - (slope or 0.0) * largest + ROUNDING * least
    ratio = largest / least * (1 - ROUNDING)
    return EigenvaluePoint(
        plan=WeightedPlan(problem.caps.copy(), least, largest),
        dual=DualBound(bound, ratio, DualPoint(0.0, 0.0, low, high)),
        slope=slope,
        profit=low,
        inside_gap=0.0,
        total_gap=0.0,
    )


# -- the active set --------------------------------------------------------------------


def _first_active_set(problem: InteriorProblem) -> Index:
    """The support of the start and an even sample, which carry more than the size."""
    count, stride = len(problem.caps), max(1, len(problem.caps) // START)
    support = np.flatnonzero(problem.start > NEGLIGIBLE * problem.caps)
    while True:
        active = np.union1d(support, np.arange(0, count, stride))
        if stride == 1 or problem.caps[active].sum() >= 1.5 * problem.size:
            return active
        stride //= 2


def _joining(problem: InteriorProblem, profit: Array, active: Index) -> Index:
    """Candidates outside that a knapsack prefers to the last one it carries inside.

    The best come first.
    """
    order = active[np.argsort(-profit[active], kind="stable")]
    last = int(np.searchsorted(np.cumsum(problem.caps[order]), problem.size))
    least_profit = profit[order[min(last, len(order) - 1)]]
    outside = np.ones(len(profit), dtype=bool)
    outside[active] = False
    joining = np.flatnonzero(outside & (profit > least_profit))
    return joining[np.argsort(-profit[joining], kind="stable")[:MORE]]


def _update_active_set(
    problem: InteriorProblem,
    profit: Array,
    weights: Array,
    active: Index,
    joining: Index,
) -> tuple[Index, Array]:
    """The active set without negligible weights, with the joining candidates.

    The weights keep their sum.
    """
    order = np.argsort(-profit, kind="stable")
    carried = np.cumsum(problem.caps[order])
    top = order[: int(np.searchsorted(carried, 1.5 * problem.size)) + 2]
    sizeable = weights > NEGLIGIBLE * problem.caps[active]
    all_weights = np.zeros(len(profit))
    all_weights[active] = np.where(sizeable, weights, 0.0)
    joined = np.union1d(np.union1d(np.flatnonzero(all_weights), joining), top)
    return joined, _raise_to_size(problem, all_weights[joined], joined)


def _raise_to_size(problem: InteriorProblem, weights: Array, active: Index) -> Array:
    """Weights raised to the size, in proportion to the room below the caps."""
    room = problem.caps[active] - weights
    missing = problem.size - weights.sum()
    return np.asarray(weights + missing * room / room.sum())
