"""Search over plans: tabu search, or exchange sweeps and restarts from a changed plan.

Plans of a given number of readings are searched by exchanges of pairs (`oed.design.tabu`);
under further rules each candidate in turn is replaced.

The search runs over a pool of candidates that an optimal plan may want, by the gradient
and weights of a relaxation. One more improvement over all candidates ends it. The
result is never worse than the greedy plans at its start.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index
from oed.design import tabu
from oed.design.evaluator import PlanEvaluator
from oed.design.quotas import QuotaSet
from oed.design.rules import Rules

POOL_SIZE = 200  #: number of candidates in the pool, at the least
POOL_PER_READING = 8  #: the same for each reading of a plan
POOL_PER_CLASS = 50  #: the same for each class of the quotas
MAX_COPIES = 4  #: number of copies of a candidate that the pool may hold for each place
#: relative difference of gradients below which two candidates count as copies: rounding
COPY_TOLERANCE = 1e-9
MIN_GAIN = 1e-10  #: gain in log phi below which an exchange counts as none
#: sweeps at the most: rounding near a singular plan could let two exchanges undo each
#: other for ever
MAX_SWEEPS = 50
#: steps of the tabu search that stand for one round, a place of the plan
STEPS_PER_PLACE = 4
#: the same for all places, at the most: tables of all pairs grow with the places
MAX_STEPS_PER_ROUND = 120
#: steps that a plan needs for each of its places until it is near a local optimum
STEPS_OF_DESCENT = 5
#: number of readings that one restart replaces, at the most: more would be a new plan
MAX_REPLACED = 6
SETUP_PROBABILITY = 0.3  #: probability that a restart replaces a whole set-up instead
CHOSEN_WEIGHT = 1e-6  #: weight from which a relaxed candidate counts as chosen
#: weight from which a relaxed candidate may be chosen: below is rounding
POSSIBLE_WEIGHT = 1e-9


def search(
    evaluator: PlanEvaluator,
    rules: Rules,
    weights: Array,
    gradient: Array,
    starts: Sequence[Index],
    rng: np.random.Generator,
    rounds: int,
) -> Index:
    """The best plan of local search from `starts`, by a relaxation's weights (C,)."""
    least_size = POOL_SIZE if rules.sole_size is None else evaluator.pair_pool
    promising = _promising(weights, gradient, rules, max(POOL_SIZE, least_size))
    pool = np.union1d(promising, np.concatenate(starts))
    pool_exchange = _Exchange(evaluator.subset(pool), rules.subset(pool))
    pool_starts = [np.searchsorted(pool, start) for start in starts]
    restarts = _Restarts(pool_exchange, rng)
    in_pool = restarts.run(weights[pool], rounds, pool_starts)
    last_level = evaluator.levels - 1
    best = improve(evaluator, rules, pool[in_pool], last_level)
    return max([best, *starts], key=lambda plan: _value(evaluator, rules, plan))


def select_greedily(
    evaluator: PlanEvaluator,
    rules: Rules,
    ridge: float,
    level: int = -1,
    weights: Array | None = None,
) -> Index:
    """Candidates added one by one, each by the criterion, with a ridge for what the
    plan does not determine yet, shared among quotas by weights (C,).
    """
    nothing = np.zeros(0, dtype=np.intp)
    return _complete(
        evaluator, rules, nothing, level % evaluator.levels, ridge, weights
    )


def _complete(
    evaluator: PlanEvaluator,
    rules: Rules,
    chosen: Index,
    level: int,
    ridge: float | None = None,
    weights: Array | None = None,
) -> Index:
    """A plan filled as `select_greedily` does; without a ridge, while values are finite."""
    count = evaluator.count
    allocation = rules.allocation(chosen, weights)
    while (allowed := rules.completions(chosen, count, allocation)).any():
        values = evaluator.values_after_adding(chosen, level, ridge)
        values = np.where(allowed, values, -np.inf)
        best = int(np.argmax(values))
        if not np.isfinite(values[best]):
            if ridge is None:
                break
            best = int(np.flatnonzero(allowed)[0])
        chosen = np.append(chosen, best)
    return chosen


def improve(
    evaluator: PlanEvaluator,
    rules: Rules,
    chosen: Index,
    level: int,
    sweeps: int = MAX_SWEEPS,
) -> Index:
    """A plan after exchange sweeps at one level, until no exchange helps."""
    return _Exchange(evaluator, rules).sweep_until_stable(chosen, level, sweeps)


def _promising(weights: Array, gradient: Array, rules: Rules, least_size: int) -> Index:
    """Candidates that an optimal plan may want, at least so many."""
    gradient_per_cost = gradient
    if rules.time is not None:
        gradient_per_cost = gradient / np.maximum(rules.time.cost, 1e-300)
    size = rules.size or int((weights > CHOSEN_WEIGHT).sum())
    places = max(least_size, POOL_PER_READING * size)
    order = np.argsort(-gradient_per_cost, kind="stable")[: MAX_COPIES * places]
    ordered = gradient_per_cost[order]
    falls = ordered[:-1] - ordered[1:] > COPY_TOLERANCE * np.abs(ordered[:-1])
    rank = np.concatenate([[0], np.cumsum(falls)])
    steepest = order[rank < places]
    heaviest = np.argsort(-weights, kind="stable")[:places]
    heaviest = heaviest[weights[heaviest] > POSSIBLE_WEIGHT]
    promising = np.union1d(steepest, heaviest)
    if rules.quotas is not None:
        promising = np.union1d(promising, _steepest_by_class(gradient, rules.quotas))
    return promising.astype(np.intp)


def _steepest_by_class(gradient: Array, quotas: QuotaSet) -> Index:
    """The candidates with the largest gradient in each class of the quotas."""
    steepest = []
    for label in np.unique(quotas.label):
        members = np.flatnonzero(quotas.label == label)
        order = np.argsort(-gradient[members], kind="stable")
        steepest.append(members[order[:POOL_PER_CLASS]])
    return np.concatenate(steepest)


def _value(evaluator: PlanEvaluator, rules: Rules, plan: Index) -> float:
    """Value of a plan; -inf where it does not keep its quotas."""
    return evaluator.value(plan) if rules.satisfied(plan) else -np.inf


@dataclasses.dataclass(frozen=True, eq=False)
class _Exchange:
    """Exchanges of one candidate for another."""

    evaluator: PlanEvaluator
    rules: Rules

    @property
    def exchanges_pairs(self) -> bool:
        """Whether all pairs are exchanged at once, instead of one candidate in turn."""
        return self.rules.sole_size is not None and self.evaluator.pair_pool > 0

    def sweep_until_stable(
        self, chosen: Index, level: int, sweeps: int = MAX_SWEEPS
    ) -> Index:
        """Exchanges until none helps, at one level."""
        if self.exchanges_pairs:
            return self.evaluator.exchange_pairs(chosen, level, sweeps)
        for _ in range(sweeps):
            chosen, changed = self._sweep(chosen, level)
            if not changed:
                break
        return chosen

    def _sweep(self, chosen: Index, level: int) -> tuple[Index, bool]:
        """Each candidate replaced by the best, and filled; whether it changed."""
        changed = False
        chosen = chosen.copy()
        current = self.evaluator.regularised_value(chosen, level)
        for position in range(len(chosen)):
            remaining = np.delete(chosen, position)
            allowed = self.rules.replacements(chosen, position, self.evaluator.count)
            values = self.evaluator.values_after_adding(remaining, level)
            values = np.where(allowed, values, -np.inf)
            best = int(np.argmax(values))
            if values[best] > current + MIN_GAIN and best != chosen[position]:
                chosen[position], current, changed = best, float(values[best]), True
        if self.rules.sole_size is not None:
            return chosen, changed
        filled = self.fill(chosen, level)
        return filled, changed or len(filled) > len(chosen)

    def fill(self, chosen: Index, level: int) -> Index:
        """Adds the best candidate while the rules allow one."""
        if not self.rules.additions(chosen, self.evaluator.count).any():
            return chosen
        return _complete(self.evaluator, self.rules, chosen, level)


@dataclasses.dataclass(frozen=True, eq=False)
class _Restarts:
    """Rounds of local search from plans that are drawn or changed at random."""

    exchange: _Exchange
    rng: np.random.Generator

    @property
    def rules(self) -> Rules:
        return self.exchange.rules

    @property
    def count(self) -> int:
        return self.exchange.evaluator.count

    def run(self, weights: Array, rounds: int, starts: Sequence[Index]) -> Index:
        """The best of given and drawn plans, then of changes of the best, improved."""
        weights = weights + 1e-4 * weights.sum() / len(weights)
        if rounds and self.exchange.exchanges_pairs:
            return self._tabu_plan(weights, rounds, starts)
        best = np.zeros(0, dtype=np.intp)
        best_value = -np.inf
        drawn = max(1, min(5, rounds // 4))
        for k in range(-len(starts), rounds):
            if k < 0:
                start = starts[k]
            elif k < drawn:
                start = self._draw(weights)
            else:
                start = self._change(best)
            chosen = start
            for level in range(self.exchange.evaluator.levels):
                chosen = self.exchange.sweep_until_stable(chosen, level)
            value = _value(self.exchange.evaluator, self.rules, chosen)
            if value > best_value or not best.size:
                best, best_value = chosen, value
        return best

    def _tabu_plan(self, weights: Array, rounds: int, starts: Sequence[Index]) -> Index:
        """The best plan of a tabu search from given and drawn plans."""
        evaluator = self.exchange.evaluator
        places = len(starts[0])
        steps = rounds * min(STEPS_PER_PLACE * places, MAX_STEPS_PER_ROUND)
        plans = min(tabu.MAX_PLANS, steps // (STEPS_OF_DESCENT * places))
        drawn = [self._draw(weights) for _ in range(len(starts), plans)]
        best = evaluator.tabu_search(np.array([*starts, *drawn]), steps, self.rng)
        return self.exchange.sweep_until_stable(best, evaluator.levels - 1)

    def _draw(self, weights: Array) -> Index:
        """A plan drawn with chances that follow the weights (Gumbel's trick)."""
        keys = np.log(weights) + self.rng.gumbel(size=len(weights))
        nothing = np.zeros(0, dtype=np.intp)
        order = np.argsort(-keys, kind="stable")
        return self._fill_in_order(nothing, order, weights)

    def _change(self, chosen: Index) -> Index:
        """The plan with up to six candidates, or one set-up, replaced at random."""
        most = min(MAX_REPLACED, len(chosen))
        number = int(self.rng.integers(min(2, most), most + 1))
        places = self.rng.choice(len(chosen), size=number, replace=False)
        setups = self.rules.setups
        if (
            setups is not None
            and self.rules.sole_size is None
            and self.rng.random() < SETUP_PROBABILITY
        ):
            setup = setups.setup[chosen]
            places = np.flatnonzero(setup == self.rng.choice(setup))
        remaining = np.delete(chosen, places)
        outside = np.setdiff1d(np.arange(self.count), chosen)
        others = self.rng.permutation(outside)
        removed = self.rng.permutation(chosen[places])
        before = np.zeros(self.count)
        before[chosen] = 1.0
        return self._fill_in_order(remaining, np.append(others, removed), before)

    def _fill_in_order(self, chosen: Index, order: Index, weights: Array) -> Index:
        """A plan filled in the given order while the rules allow, by weights (C,)."""
        size = self.rules.sole_size
        if size is not None:
            missing = size - len(chosen)
            return np.append(chosen, order[:missing]).astype(np.intp)
        rank = np.full(self.count, np.inf)
        rank[order] = np.arange(len(order))
        allocation = None
        if self.rules.quotas is not None:
            allocation = self.rules.allocation(chosen, weights, self.rng)
        while (free := self.rules.completions(chosen, self.count, allocation)).any():
            first = int(np.argmin(np.where(free, rank, np.inf)))
            if not np.isfinite(rank[first]):
                break
            chosen = np.append(chosen, first)
        return chosen.astype(np.intp)
