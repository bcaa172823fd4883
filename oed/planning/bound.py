"""Lower bound of the goal over all plans within the budget: a certificate for a plan.

Each combination T of options has an upper bound of log phi, phi = 1 / value^2. One
supporting line bounds all combinations at once. The combination
with the highest bound is then solved as a relaxation, which gives a new line, tight
there. This goes on until no combination can be better than the loss allows.

The bound of a combination comes by duality. A plan that mounts the options T and reads
candidates i of them, at most N_s of option s, leaves at most the information L = L0 +
sum_(s in T) S_s about the machine, with the set-ups' parameters profiled out:

    S_s = min over G of  sum_(i in s) w_i (x_i - z_i G)^T (x_i - z_i G) + G^T G.

x_i and z_i are the parts of a candidate's rows on machine and set-up (prior variances
of 1). Any G bounds S_s by something linear in w. With a supporting line of the
criterion at any L, log phi(L') <= v + log <R R^T, L'>, this gives

    phi(T) <= exp(v) ( <R R^T, L0> + min over prices l >= 0 of  l (B - sum_T mounting_s)
               + sum_(s in T) [ |G_s R|^2 + sum_(N_s largest i in s) max(0, g_i - l c_i) ] )

with gains g_i = |(x_i - z_i G_s) R|^2, times c_i and the budget B.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.design import relax
from oed.linear_algebra import precision_root
from oed.planning.option import Option
from oed.planning.problem import PlanProblem
from oed.planning.travel import capture_probability_bound, is_captured

LOG_ROUNDING = 1e-12  #: allowance for the rounding of a line's logarithms, in log phi
#: prices of time to try, as shares of the highest gain a candidate has for its time
PRICES = np.append(0.0, np.geomspace(1e-5, 1.0, 40))
RELAXATION_TOLERANCE = 3e-3  #: gap in log phi of a combination's relaxation
MAX_PRICE_STEPS = 6  #: number of relaxations in which the prices of readings settle
#: share by which the numbers of readings may then exceed their limits
LIMIT_EXCESS = 0.02
MAX_LINES = 150  #: supporting lines that are computed
OUTSIDE_SHARE = 0.5  #: weight of the candidates of options that are not in a relaxation


@dataclasses.dataclass(frozen=True, eq=False)
class CombinationBound:
    """The options of a planning problem with their bounds."""

    parts: "tuple[OptionBound, ...]"
    mounting: Array  #: (options,) time to mount each, s
    problem: PlanProblem

    @classmethod
    def of(cls, problem: PlanProblem) -> "CombinationBound":
        """The bound for the options of a problem."""
        n = problem.goal.parameters
        return cls(
            parts=tuple(OptionBound.of(option, n) for option in problem.options),
            mounting=_mounting_seconds(problem),
            problem=problem,
        )

    def relax(self, members: Sequence[int]) -> dict[int, Array]:
        """Best relaxed weights {option: (C,)} of a combination within the budget."""
        parts = [self.parts[s] for s in members]
        n = self.problem.goal.parameters
        rows = _joint_rows(parts, n)
        base = np.eye(rows.shape[2])
        base[:n, :n] = self.problem.information
        time = self.problem.budget - float(self.mounting[list(members)].sum())
        weights = self._settle_prices(parts, rows, base, time)
        ends = np.cumsum([len(part.cost) for part in parts])[:-1]
        return dict(zip(members, np.split(weights, ends), strict=True))

    def _settle_prices(
        self, parts: "Sequence[OptionBound]", rows: Array, base: Array, time: float
    ) -> Array:
        """Best weights of all candidates, within the time and each option's number.

        Time is the only price. A reading of an option whose number is exceeded costs
        extra seconds, until no number is exceeded.
        """
        sizes = [len(part.cost) for part in parts]
        part_of = np.repeat(np.arange(len(parts)), sizes)
        seconds = np.concatenate([part.cost for part in parts])
        limit = np.array([part.limit for part in parts])
        mean = np.array([part.cost.mean() for part in parts])
        time = min(time, sum(part.longest for part in parts))
        goal = self.problem.goal
        criterion = goal.criterion(rows.shape[2] - goal.parameters).relaxed
        price = mean
        for _ in range(MAX_PRICE_STEPS):
            extra = price - mean
            cost = seconds + extra[part_of]
            total = min(time + float(extra @ limit), float(cost.sum()))
            scaled = rows / np.sqrt(cost)[:, None, None]
            relaxed = relax(scaled, total, base, cost, RELAXATION_TOLERANCE, criterion)
            weights = np.asarray(relaxed.weights / cost)
            used = np.bincount(part_of, weights)
            if (used <= limit * (1.0 + LIMIT_EXCESS)).all():
                break
            price = np.maximum(mean, price * used / limit)
        return weights

    def bound_all(self, combinations: Index, weights: dict[int, Array]) -> Array:
        """Bound (T,) of log phi of every combination, by the line at some weights."""
        profiles = []
        for s, part in enumerate(self.parts):
            outside = np.full(len(part.cost), OUTSIDE_SHARE)
            profiles.append(part.profile(weights.get(s, outside)))
        added = sum(
            self.parts[s].information(w, profiles[s]) for s, w in weights.items()
        )
        before = self.problem.information
        criterion = self.problem.goal.criterion(0).relaxed
        line = criterion.support(np.asarray(before + added))
        worth, prices = self._worth(profiles, line.root)
        total = worth[combinations].sum(axis=1) + prices * self.problem.budget
        least_worth = total.min(axis=1)
        prior = float(np.sum((before @ line.root) * line.root))
        return np.asarray(line.value + np.log(prior + least_worth) + LOG_ROUNDING)

    def _worth(self, profiles: Sequence[Array], root: Array) -> tuple[Array, Array]:
        """Worth (options + 1, P) at each price, none last, and prices (P,)."""
        pairs = zip(self.parts, profiles, strict=True)
        gains = [part.gain(profile, root) for part, profile in pairs]
        of_parts = list(zip(self.parts, gains, profiles, self.mounting, strict=True))
        rates = [float((gain / part.cost).max()) for part, gain, _, _ in of_parts]
        prices = PRICES * max(rates)
        rows = []
        for part, gain, profile, seconds in of_parts:
            constant = float(np.sum((profile @ root) ** 2))
            rows.append(part.worth(gain, prices) + constant - prices * seconds)
        return np.vstack([*rows, np.zeros(len(prices))]), prices


def _joint_rows(parts: "Sequence[OptionBound]", n: int) -> Array:
    """Rows (C, k, w) of all candidates over machine and all set-ups' parameters."""
    width = n + sum(part.setup.shape[2] for part in parts)
    height = max(part.machine.shape[1] for part in parts)
    blocks = []
    start = n
    for part in parts:
        count, k = part.machine.shape[:2]
        end = start + part.setup.shape[2]
        block = np.zeros((count, height, width))
        block[:, :k, :n] = part.machine
        block[:, :k, start:end] = part.setup
        blocks.append(block)
        start = end
    return np.concatenate(blocks)


# -- one option ------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class OptionBound:
    """Candidates (C) of an option, weighted with a bound of their capture probability."""

    machine: Array  #: (C, k, n) parts of the rows on the machine's parameters
    setup: Array  #: (C, k, r) parts of the rows on the option's other unknowns
    cost: Array  #: (C,) time of each candidate, s
    limit: int  #: largest number of candidates in a plan

    @classmethod
    def of(cls, option: Option, n: int) -> "OptionBound":
        """An option whose readings are lost to its set-up's unknowns alone."""
        probability = capture_probability_bound(option, np.zeros((n, n)))
        weights = np.sqrt(probability)[:, None, None]
        blocks = option.candidates.blocks * weights
        return cls(
            machine=blocks[:, :, :n],
            setup=blocks[:, :, n:],
            cost=option.candidate_seconds,
            limit=option.counts[-1],
        )

    @property
    def longest(self) -> float:
        """Longest time (s) that the readings of a plan can take."""
        return float(np.sort(self.cost)[-self.limit :].sum())

    def profile(self, weights: Array) -> Array:
        """G (r, n) that attains the minimum S at weights (C,)."""
        of_setup = np.einsum(
            "c,ckr,cks->rs", weights, self.setup, self.setup, optimize=True
        )
        mixed = np.einsum(
            "c,ckr,ckn->rn", weights, self.setup, self.machine, optimize=True
        )
        return np.linalg.solve(of_setup + np.eye(len(of_setup)), mixed)

    def information(self, weights: Array, profile: Array) -> Array:
        """S (n, n) at weights (C,) and a profile G (r, n)."""
        residual = self.machine - self.setup @ profile
        weighted = residual * np.sqrt(weights)[:, None, None]
        rows = weighted.reshape(-1, weighted.shape[2])
        return rows.T @ rows + profile.T @ profile

    def gain(self, profile: Array, root: Array) -> Array:
        """Gain (C,) of each candidate, |(x - z G) R|^2."""
        moved = (self.machine - self.setup @ profile) @ root
        return np.asarray(np.sum(moved**2, axis=(1, 2)))

    def worth(self, gain: Array, prices: Array) -> Array:
        """Largest total (P,) of `limit` gains (C,) less the price of time (P,)."""
        net = np.maximum(gain - prices[:, None] * self.cost, 0.0)
        if self.limit < net.shape[1]:
            net = np.partition(net, -self.limit, axis=1)[:, -self.limit :]
        return np.asarray(net.sum(axis=1))


MAX_COMBINATIONS = 200_000  #: largest number of combinations that are bounded
PROMISING_COMBINATIONS = 4  #: combinations that are reported as promising
#: gain of a line in log phi below which a relaxation has reached its own tolerance
STUCK_GAIN = 1e-9
MACHINES_DRAWN = 4000  #: machines drawn
SAFETY_FACTOR = 4.0  #: standard errors by which the estimate is lowered
COMBINATIONS_AT_ONCE = 1000  #: combinations which are treated at once
MIN_NUMBER = 1e-300  #: smallest value, so that its logarithm exists


@dataclasses.dataclass(frozen=True)
class GoalBound:
    """No plan within the budget has a smaller goal value than `value`."""

    value: float
    lines: int  #: supporting lines that were computed
    #: combinations that can hold a better plan, most promising first, as {position of
    #: the option: relaxed number of readings}
    promising: tuple[dict[int, float], ...] = ()


def bound_goal(problem: PlanProblem, value: float, loss: float = 0.05) -> GoalBound:
    """Bound the goal over all plans of a problem, by lines until `value` is certified
    within `loss`, or MAX_LINES. Raises ValueError for too many combinations.
    """
    combinations = _combinations(
        _mounting_seconds(problem), problem.budget, problem.stages
    )
    if not len(combinations):
        return GoalBound(np.inf, 0)
    least = bound_uncaptured(problem, combinations)
    upper = -2.0 * np.log(least)
    goal_bound = CombinationBound.of(problem)
    rest = problem.goal.least_rest
    target = _log_phi(_reducible(value / (1.0 + loss), rest))
    relaxed: dict[int, dict[int, float]] = {}
    computed = 0
    while computed < MAX_LINES:
        best = int(np.argmax(upper))
        if upper[best] <= target:
            break
        members = [position for position in combinations[best] if position >= 0]
        weights = goal_bound.relax(members)
        relaxed[best] = {int(s): float(w.sum()) for s, w in weights.items()}
        line = goal_bound.bound_all(combinations, weights)
        is_stuck = line[best] >= upper[best] - STUCK_GAIN
        upper = np.minimum(upper, line)
        computed += 1
        if is_stuck:
            break
    highest = float(upper.max())
    least_better = _log_phi(_reducible(value, rest))
    better = [k for k in relaxed if upper[k] > least_better]
    ranked = sorted(better, key=lambda k: -upper[k])
    promising = tuple(relaxed[k] for k in ranked[:PROMISING_COMBINATIONS])
    total = math.sqrt(math.exp(-highest) + rest)
    return GoalBound(total, computed, promising)


def _mounting_seconds(problem: PlanProblem) -> Array:
    """Time (options,) to mount each option, s."""
    return np.array([option.mounting_seconds for option in problem.options])


def _reducible(value: float, rest: float) -> float:
    """The part of a goal value that readings reduce."""
    return math.sqrt(max(value**2 - rest, MIN_NUMBER))


def _log_phi(value: float) -> float:
    return -2.0 * math.log(value)


def _combinations(mounting: Array, budget: float, stages: int) -> Index:
    """Combinations (T, stages) of options that the budget mounts, padded with -1."""
    count = len(mounting)
    stages = min(stages, count)
    total = sum(math.comb(count, size) for size in range(1, stages + 1))
    if total > MAX_COMBINATIONS:
        raise ValueError(
            f"{total} combinations of {stages} of {count} measurements are too many to bound"
        )
    tables = []
    for size in range(1, stages + 1):
        rows = list(itertools.combinations(range(count), size))
        table = np.array(rows, dtype=np.intp)
        table = table[mounting[table].sum(axis=1) < budget]
        padding = ((0, 0), (0, stages - size))
        tables.append(np.pad(table, padding, constant_values=-1))
    return np.concatenate(tables)


# -- machines that no reading captures -------------------------------------------------
def bound_uncaptured(problem: PlanProblem, combinations: Index) -> Array:
    """Goal value (T,) at the least of combinations (T, stages) of options, from drawn
    machines less four standard errors.
    """
    options, goal, rng = problem.options, problem.goal, problem.streams.bound
    root = precision_root(problem.information)
    errors = rng.standard_normal((MACHINES_DRAWN, goal.parameters)) @ root.T
    uncaptured = _uncaptured(options, errors, rng)
    squared = [np.sum((errors @ factor.T) ** 2, axis=1) for factor in goal.factors]
    squares = np.stack(squared, axis=1)
    least = np.zeros(len(combinations))
    everything = np.arange(len(combinations))
    for part in np.array_split(
        everything, max(len(combinations) // COMBINATIONS_AT_ONCE, 1)
    ):
        excluded = uncaptured[combinations[part]].all(axis=1).astype(float)
        mean = excluded @ squares / MACHINES_DRAWN
        variance = np.maximum(excluded @ squares**2 / MACHINES_DRAWN - mean**2, 0.0)
        standard_error = np.sqrt(variance / MACHINES_DRAWN)
        lowered = np.maximum(mean - SAFETY_FACTOR * standard_error, 0.0)
        least[part] = goal.combine(np.sqrt(lowered))
    return np.maximum(least, MIN_NUMBER)


def _uncaptured(
    options: Sequence[Option], errors: Array, rng: np.random.Generator
) -> Mask:
    """Machines that no candidate of an option captures: (options + 1, machines)."""
    uncaptured = np.zeros((len(options) + 1, len(errors)), dtype=bool)
    uncaptured[-1] = True
    for k, option in enumerate(options):
        if not option.limits_travel:
            continue
        setup_errors = rng.standard_normal((len(errors), option.setup_columns))
        everything = np.arange(len(option.candidates))
        captured = is_captured(option, everything, errors, setup_errors)
        uncaptured[k] = ~captured.any(axis=1)
    return uncaptured
