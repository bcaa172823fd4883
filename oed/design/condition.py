"""Bounds of the condition number, O4 and E: relaxations with certificates.

With M = M0 + sum_i w_i A_i, A_i = X_i^T X_i, its extreme eigenvalues l_min and l_max,
0 <= w_i <= cap_i, sum w = N,

    F(z) = max_w  l_min(M) - z l_max(M)

is a concave problem. F(0) is the E criterion. F(z) = 0
at z = 1 / kappa^2 of the best plan, kappa = sqrt(l_max / l_min) (Dinkelbach 1967,
Management Science 13, 492-498). As l_min <= F(z) + z l_max for every z, lines of
several z bound O4 = l_min / sqrt(l_max): no plan lies above their lower envelope. Along
a line O4 is largest at an end, so only corners of the envelope can exceed what is
known. The next z is the slope between the plans on both sides of the worst corner
(sandwich algorithm, Rote 1992, Computing 48, 337-361).

F(z), and the least l_max / l_min, are computed on a growing active set. Bounds rest on
dual points alone, whatever the method did. For any Y, Z positive semidefinite of trace
1

    l_max(M) - s l_min(M) >= <Z - s Y, M>,       l_min(M) - z l_max(M) <= <Y - z Z, M>,

and their extremes over all weights are those of a fractional knapsack. So kappa^2 is at
least the least <Z, M> / <Y, M> over the weights, and F(z) is at most the largest
<Y - z Z, M>. The points are those of the path of `oed.design.interior`.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import information
from oed.design.forms import ExtremeEigenvalues
from oed.design.forms.protocol import weight_gradient
from oed.design.interior import InteriorPath, InteriorProblem, build_problem
from oed.design.objective import knapsack_value, knapsack_weights
from oed.design.relaxation import Relaxation

MAX_ROUNDS = 40  #: number of rounds in which candidates join
MAX_STEPS = 60  #: number of steps of a path
START_SIZE = 200  #: number of candidates in the first active set
JOINING_SIZE = 100  #: number of candidates that join in a round
#: a path ends where the active set causes less than this share of the duality gap: the
#: others are due to candidates outside
INSIDE_SHARE = 0.1
#: allowance for the rounding of traces, a share of the least eigenvalue (and of kappa)
BOUND_ROUNDING = 1e-10
NEGLIGIBLE_WEIGHT = 1e-4  #: weights below this share of their cap count as none


class DualPoint(NamedTuple):
    """Products of Y and Z with the prior information and with each candidate."""

    #: <Y, M0>, <Z, M0>
    base_low: float
    base_high: float
    #: (C,) <Y, A_i>, <Z, A_i>
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
    """Weights with their extreme eigenvalues, and the bound that a dual point implies."""

    plan: WeightedPlan  #: weights and their eigenvalues
    dual: DualBound  #: the bound
    slope: float | None  #: z; None for kappa
    profit: Array  #: (C,) <Y - z Z, A_i> at the path's z
    inside_gap: float  #: duality gap over the active set alone, as a share of l_min
    total_gap: float  #: duality gap over all candidates, as a share of l_min

    @property
    def duality_gap(self) -> float:
        """Of the bound as a share of l_min, or of the ratio as a share of kappa^2."""
        if self.slope is None:
            return self.plan.largest / self.plan.least / self.dual.ratio - 1.0
        above = self.dual.bound - self.plan.least + self.slope * self.plan.largest
        return above / self.plan.least

    def combine(self, other: "EigenvaluePoint") -> "EigenvaluePoint":
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
    """F(slope), or the least kappa, to a gap `tolerance` of l_min, or of kappa^2."""
    if problem.caps.sum() <= problem.size * (1 + 1e-9):
        return _only_plan(problem, slope)
    active = _first_active_set(problem)
    weights = _raise_to_size(problem, problem.start[active], active)
    centre = 0.5
    best: EigenvaluePoint | None = None
    for _ in range(MAX_ROUNDS):
        known_slope = 0.0 if best is None else _slope_below(best, tolerance)
        part = problem.subset(active)
        path = InteriorPath(part, slope, weights, centre, known_slope)
        now: EigenvaluePoint | None = None
        for _ in range(MAX_STEPS):
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
            problem, now.profit, path.iterate.w, active, joining
        )
        centre = float(np.clip(now.total_gap, 0.02, 0.3))
    if best is None:
        raise ValueError(
            "the scales of the columns differ too much for their condition number: scale them"
        )
    return best


def _slope_below(best: EigenvaluePoint, tolerance: float) -> float:
    """A slope below the best plan's l_min / l_max: at it all sizes are as good."""
    return best.plan.least / best.plan.largest * (1.0 - 0.2 * tolerance)


def _evaluate(
    problem: InteriorProblem, path: InteriorPath, active: Index
) -> EigenvaluePoint:
    """The path's weights and duals, over all candidates."""
    dual = _dual_point(problem, path)
    weights = path.iterate.w
    least, largest = problem.extreme_eigenvalues(active, weights)
    profit = dual.low - path.slope * dual.high
    base_profit = dual.base_low - path.slope * dual.base_high
    value = least - path.slope * largest
    size, caps = problem.size, problem.caps
    carried_inside = knapsack_value(profit[active], size, caps[active])
    bound = base_profit + knapsack_value(profit, size, caps)
    rounding = BOUND_ROUNDING + 4e-16 * float(np.sqrt(largest / least))
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
    y = np.asarray(np.linalg.cholesky(path.iterate.y))
    y = y / float(np.linalg.norm(problem.turn.T @ y))
    z = np.zeros((len(path.iterate.y), 1))
    if path.slope:
        z = np.asarray(np.linalg.cholesky(path.iterate.z))
        z = z / float(np.linalg.norm(z))
    return DualPoint(
        float(np.sum((problem.white_base @ y) * y)),
        float(np.sum((problem.base @ z) * z)),
        weight_gradient(problem.white, y),
        weight_gradient(problem.blocks, z),
    )


def _least_ratio(problem: InteriorProblem, dual: DualPoint, ratio: float) -> float:
    """The least <Z, M> / <Y, M> over all weights, by Dinkelbach's steps from above."""
    for _ in range(100):
        w = knapsack_weights(ratio * dual.low - dual.high, problem.size, problem.caps)
        numerator = dual.base_high + dual.high @ w
        denominator = dual.base_low + dual.low @ w
        if numerator >= ratio * denominator * (1 - 1e-14):
            return ratio
        ratio = float(numerator / denominator)
    return 0.0


def _only_plan(problem: InteriorProblem, slope: float | None) -> EigenvaluePoint:
    """The only plan, where the caps leave no choice."""
    everything = np.arange(len(problem.blocks))
    least, largest = problem.extreme_eigenvalues(everything, problem.caps)
    m = problem.base + information(problem.blocks, problem.caps)
    eigenvectors = np.linalg.eigh(m)[1]
    low = weight_gradient(problem.blocks, eigenvectors[:, :1])
    high = weight_gradient(problem.blocks, eigenvectors[:, -1:])
    bound = least - (slope or 0.0) * largest + BOUND_ROUNDING * least
    ratio = largest / least * (1 - BOUND_ROUNDING)
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
    count, stride = len(problem.caps), max(1, len(problem.caps) // START_SIZE)
    support = np.flatnonzero(problem.start > NEGLIGIBLE_WEIGHT * problem.caps)
    while True:
        active = np.union1d(support, np.arange(0, count, stride))
        if stride == 1 or problem.caps[active].sum() >= 1.5 * problem.size:
            return active
        stride //= 2


def _joining(problem: InteriorProblem, profit: Array, active: Index) -> Index:
    """Candidates outside that a knapsack prefers to the last one inside, best first."""
    order = active[np.argsort(-profit[active], kind="stable")]
    last = int(np.searchsorted(np.cumsum(problem.caps[order]), problem.size))
    least_profit = profit[order[min(last, len(order) - 1)]]
    outside = np.ones(len(profit), dtype=bool)
    outside[active] = False
    joining = np.flatnonzero(outside & (profit > least_profit))
    return joining[np.argsort(-profit[joining], kind="stable")[:JOINING_SIZE]]


def _update_active_set(
    problem: InteriorProblem,
    profit: Array,
    weights: Array,
    active: Index,
    joining: Index,
) -> tuple[Index, Array]:
    """The active set with joining candidates, without weights that are negligible."""
    order = np.argsort(-profit, kind="stable")
    filled = np.cumsum(problem.caps[order])
    top = order[: int(np.searchsorted(filled, 1.5 * problem.size)) + 2]
    sizeable = weights > NEGLIGIBLE_WEIGHT * problem.caps[active]
    all_weights = np.zeros(len(profit))
    all_weights[active] = np.where(sizeable, weights, 0.0)
    joined = np.union1d(np.union1d(np.flatnonzero(all_weights), joining), top)
    return joined, _raise_to_size(problem, all_weights[joined], joined)


def _raise_to_size(problem: InteriorProblem, weights: Array, active: Index) -> Array:
    """Weights raised to the size, in proportion to the room below the caps."""
    room = problem.caps[active] - weights
    missing = problem.size - weights.sum()
    return np.asarray(weights + missing * room / room.sum())


TOLERANCE = 1e-4  #: log duality gap to which E and kappa are solved
O4_TOLERANCE = 1e-3  #: the same for O4, which takes several paths
MAX_LINES = 16  #: lines that bound O4, at the most
LINE_TOLERANCE = 0.3  #: share of the tolerance that each line of O4 is solved to


def relax(
    criterion: ExtremeEigenvalues,
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float | None = None,
) -> Relaxation:
    """Optimal weights for E, kappa and O4, or powers of them; value and bound are log phi.

    tolerance  log duality gap of l_min, of kappa = sqrt(l_max / l_min), or of
               O4 = l_min / sqrt(l_max); TOLERANCE or O4_TOLERANCE by default

    Other arguments as for `relaxation.relax`. Raises ValueError where the caps cannot carry
    `size`, where candidates and prior leave directions undetermined, and for another
    ratio of the two eigenvalues.
    """
    least, largest = criterion.least, criterion.largest
    if largest not in (0.0, least, least / 2.0):
        raise ValueError(
            f"{criterion.name} has no relaxation: see oed.design.condition"
        )
    problem = build_problem(rows, size, prior, cap)
    if criterion.concave:
        point = follow(problem, 0.0, tolerance or TOLERANCE)
        bound = float(np.log(point.dual.bound))
    elif least == largest:
        point = follow(problem, None, 2.0 * (tolerance or TOLERANCE))
        bound = -float(np.log(point.dual.ratio))
    else:
        point, o4 = _relax_o4(problem, tolerance or O4_TOLERANCE)
        bound = float(np.log(o4))
    plan, products = point.plan, point.dual.point
    value = least * np.log(max(plan.least, 1e-300)) - largest * np.log(plan.largest)
    low, high = products.low / plan.least, products.high / plan.largest
    gradient = least * low - largest * high
    return Relaxation(plan.weights, float(value), least * bound, gradient)


def _relax_o4(
    problem: InteriorProblem, tolerance: float
) -> tuple[EigenvaluePoint, float]:
    """Nearly the largest O4, and its bound, to a log duality gap."""
    line_tolerance = LINE_TOLERANCE * tolerance
    level = follow(problem, 0.0, line_tolerance)
    through_origin = follow(problem, None, line_tolerance)
    lines = [
        _Line(level.dual.bound, 0.0, level),
        _Line(0.0, 1.0 / through_origin.dual.ratio, through_origin),
    ]
    best = max((level, through_origin), key=_o4)
    while True:
        bound, flatter, steeper = _worst_corner(lines)
        if np.log(bound / _o4(best)) <= tolerance or len(lines) >= MAX_LINES:
            return best, bound
        slope = _slope_between(flatter, steeper)
        near = dataclasses.replace(problem, start=flatter.point.plan.weights)
        point = follow(near, slope, line_tolerance)
        lines.append(_Line(point.dual.bound, slope, point))
        best = max(best, point, key=_o4)


class _Line(NamedTuple):
    """l_min <= constant + slope l_max for all plans; `point` nearly attains it."""

    constant: float
    slope: float
    point: EigenvaluePoint


def _o4(point: EigenvaluePoint) -> float:
    return float(point.plan.least / np.sqrt(point.plan.largest))


def _worst_corner(lines: list[_Line]) -> tuple[float, _Line, _Line]:
    """Largest l_min / sqrt(l_max) under the lines, and the two that meet there.

    The flatter line comes first. The first line is level and one passes through the
    origin, so the envelope's largest value is at a crossing.
    """
    constant = np.array([line.constant for line in lines])
    slope = np.array([line.slope for line in lines])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (constant[:, None] - constant) / (slope - slope[:, None])
    steeper_than = slope > slope[:, None]
    pairs = np.isfinite(crossing) & (crossing > 0) & steeper_than
    flatter, steeper = np.nonzero(pairs)
    meeting = crossing[flatter, steeper]
    envelope = np.min(constant + meeting[:, None] * slope, axis=1)
    height = constant[flatter] + meeting * slope[flatter]
    on_envelope = envelope >= height * (1 - 1e-12)
    values = np.where(on_envelope, envelope / np.sqrt(meeting), -np.inf)
    k = int(np.argmax(values))
    bound = float(values[k]) * (1.0 + BOUND_ROUNDING)
    return bound, lines[int(flatter[k])], lines[int(steeper[k])]


def _slope_between(flatter: _Line, steeper: _Line) -> float:
    """Slope of the chord between plans that lines touch, or halfway of both."""
    run = flatter.point.plan.largest - steeper.point.plan.largest
    rise = flatter.point.plan.least - steeper.point.plan.least
    chord = rise / run if run > 0 else -1.0
    margin = 0.01 * (steeper.slope - flatter.slope)
    if flatter.slope + margin < chord < steeper.slope - margin:
        return float(chord)
    return 0.5 * (flatter.slope + steeper.slope)
