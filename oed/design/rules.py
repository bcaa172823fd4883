"""Rules of a plan: number of readings, time, set-ups, distances, and quotas.

Whether a candidate can be read at all (workspace, joint travel, singularity, bar
travel, collisions) is decided earlier (`oed.poses.feasible`). These rules hold between
the readings of one plan.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oed.base import Array, Index, Mask
from oed.design.quotas import QuotaSet


@dataclasses.dataclass(frozen=True, eq=False)
class TimeBudget:
    """Time of C candidates, `cost` (C,), of which a plan may take `available`; s."""

    cost: Array
    available: float = math.inf  #: infinite where time is stated, and no rule

    def __post_init__(self) -> None:
        if self.is_limited and not (np.asarray(self.cost) > 0).all():
            raise ValueError("a budget needs the positive cost of every candidate")

    @property
    def is_limited(self) -> bool:
        """Whether it is a rule."""
        return math.isfinite(self.available)

    def subset(self, pool: Index) -> TimeBudget:
        """The times of a part of the candidates."""
        return dataclasses.replace(self, cost=self.cost[pool])

    def allows(self, seconds: Array) -> Mask:
        """Which times of plans, s, fit into the budget."""
        return np.asarray(seconds <= self.available * (1 + 1e-12))

    def total(self, candidates: Index, mounting: float = 0.0) -> float:
        """Time for readings of the candidates after mounting, s, at the most."""
        cost = self.cost[candidates]
        return float(min(self.available - mounting, cost.sum()))


@dataclasses.dataclass(frozen=True, eq=False)
class SetupLimit:
    """Set-ups of C candidates, the time to mount them, and how many there may be."""

    setup: Index  #: (C,) number of the set-up of each candidate
    #: (S,) time to mount each set-up, s, paid once; None where that is no rule
    seconds: Array | None = None
    most: int | None = None  #: number of set-ups at the most; None: any number
    #: set-ups that are mounted already: they cost nothing and do not count
    mounted: tuple[int, ...] = ()

    @property
    def mountable(self) -> Index:
        """Set-ups that are not mounted yet."""
        return self._to_mount(self.setup)

    def most_of(self, count: int) -> int:
        """The largest number of `count` set-ups that a plan may mount."""
        return min(self.most or count, count)

    def mounting_time(self, chosen: Index) -> float:
        """Time to mount the set-ups of a plan, s."""
        return self._seconds_of(self._to_mount(self.setup[chosen]))

    def mounting_times(self, chosen: Index) -> Array:
        """Time to mount (C,), s, that each candidate adds to a plan."""
        if self.seconds is None:
            return np.zeros(len(self.setup))
        return np.where(self._unmounted(chosen), self.seconds[self.setup], 0.0)

    def additions(self, chosen: Index) -> Mask:
        """Which of the candidates (C,) may join a plan."""
        free = np.ones(len(self.setup), dtype=bool)
        if self.most is None or len(self._to_mount(self.setup[chosen])) < self.most:
            return free
        return free & ~self._unmounted(chosen)

    def combinations(
        self, names: Index, sizes: Sequence[int]
    ) -> Iterator[tuple[Index, float]]:
        """Candidates of each combination of some set-ups, and its time to mount, s."""
        for size in sizes:
            for combination in itertools.combinations(names, size):
                allowed = [*combination, *self.mounted]
                candidates = np.flatnonzero(np.isin(self.setup, allowed))
                yield candidates, self._seconds_of(list(combination))

    def subset(self, pool: Index) -> SetupLimit:
        """The rule over a part of the candidates."""
        return dataclasses.replace(self, setup=self.setup[pool])

    def _seconds_of(self, setups: Index | list[int]) -> float:
        if self.seconds is None:
            return 0.0
        return float(self.seconds[setups].sum())

    def _to_mount(self, setups: Index) -> Index:
        """Set-ups of these, ascending, that are not mounted."""
        return np.setdiff1d(setups, np.array(self.mounted, dtype=np.intp))

    def _unmounted(self, chosen: Index) -> Mask:
        """Candidates whose set-up a plan does not mount."""
        mounted = np.array(self.mounted, dtype=np.intp)
        present = np.append(self._to_mount(self.setup[chosen]), mounted)
        return ~np.isin(self.setup, present)


@dataclasses.dataclass(frozen=True, eq=False)
class DistanceLimit:
    """Least distance of two readings of one set-up."""

    position: Array  #: (C, d) of each candidate, in units of its own
    least: float  #: least distance

    def too_near(self, member: int) -> Mask:
        """Candidates (C,) too near to one of them, whatever their set-up."""
        distance = np.linalg.norm(self.position - self.position[member], axis=1)
        return np.asarray(distance < self.least * (1 - 1e-9))

    def subset(self, pool: Index) -> DistanceLimit:
        """The rule over a part of the candidates."""
        return DistanceLimit(self.position[pool], self.least)


if TYPE_CHECKING:
    from oed.design.evaluator import PlanEvaluator
    from oed.design.forms import Criterion
    from oed.design.objective import Objective
    from oed.design.relaxation import Relaxation

#: combinations of set-ups that are bounded one by one, at the most
MAX_COMBINATIONS = 64
#: standard deviation of the logarithm of the classes' numbers, where they are varied
LOG_VARIATION = 0.5


class RelaxedRules(NamedTuple):
    """A convex problem: weights 0 <= w <= 1 on `candidates` with one sum held.

    The sum is sum w = total, or sum cost w = total where a cost is given.
    """

    candidates: Index
    total: float
    cost: Array | None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rules:
    """Rules of a plan over C candidates; a size or a budget is given, or both."""

    #: number of candidates to choose; with a budget, at the most
    size: int | None = None
    #: time of each candidate, and the budget, which limits their sum
    time: TimeBudget | None = None
    #: set-up of each candidate, time to mount it, and number of set-ups
    setups: SetupLimit | None = None
    #: least distance of two chosen candidates of one set-up
    distance: DistanceLimit | None = None
    #: numbers to take from selections of the candidates; they need `size`, and go
    #: neither with a budget nor with a number of set-ups
    quotas: QuotaSet | None = None

    def __post_init__(self) -> None:
        if self.size is None and self.budget is None:
            raise ValueError("a plan needs a number of readings or a budget")
        if self.quotas is not None:
            free_number = self.budget is not None or self.limits_setups
            if free_number or self.size != self.quotas.size:
                raise ValueError("quotas need the number of readings, and no budget")

    @classmethod
    def build(
        cls,
        *,
        size: int | None = None,
        seconds: Array | None = None,
        budget: float | None = None,
        setup: Index | None = None,
        mounting: Array | None = None,
        most_setups: int | None = None,
        mounted: tuple[int, ...] = (),
        position: Array | None = None,
        least_distance: float = 1.0,
        quotas: QuotaSet | None = None,
    ) -> Rules:
        """Rules over C candidates.

        seconds         (C,) time of each; with a `budget`, s, their sum is limited
        setup           (C,) number of the set-up of each
        mounting        (S,) time to mount each set-up, s; None where that is no rule
        most_setups     number of set-ups at the most
        mounted         set-ups that are mounted already
        position        (C, d) of each; two chosen of one set-up are `least_distance`
                        apart

        Raises ValueError without size and budget, and for a budget without times.
        """
        time = None
        if seconds is not None or budget is not None:
            cost = np.zeros(1) if seconds is None else seconds
            time = TimeBudget(cost, math.inf if budget is None else budget)
        setups = None
        if setup is not None:
            setups = SetupLimit(setup, mounting, most_setups, mounted)
        distance = None
        if position is not None:
            distance = DistanceLimit(position, least_distance)
        return cls(
            size=size, time=time, setups=setups, distance=distance, quotas=quotas
        )

    @property
    def budget(self) -> TimeBudget | None:
        """The time available, where it is limited."""
        limited = self.time is not None and self.time.is_limited
        return self.time if limited else None

    @property
    def limits_setups(self) -> bool:
        """Whether the number of set-ups is limited."""
        return self.setups is not None and self.setups.most is not None

    @property
    def sole_size(self) -> int | None:
        """The number of candidates where it is the only rule; else None."""
        others = self.budget, self.distance, self.quotas
        if self.limits_setups or any(rule is not None for rule in others):
            return None
        return self.size

    @property
    def any_setups(self) -> Rules:
        """The rules with any number of set-ups."""
        return self if self.setups is None else self.free_setups(self.setups)

    def free_setups(self, setups: SetupLimit) -> Rules:
        """The rules with these set-ups, and any number of them."""
        unlimited = dataclasses.replace(setups, most=None)
        return dataclasses.replace(self, setups=unlimited)

    def totals(
        self, candidates: Index, mounting: float = 0.0
    ) -> list[tuple[float, Array | None]]:
        """Sums that weights or costs of candidates are held to after mounting, s."""
        totals: list[tuple[float, Array | None]] = []
        if self.size is not None:
            totals.append((float(min(self.size, len(candidates))), None))
        if self.budget is not None:
            total = self.budget.total(candidates, mounting)
            totals.append((total, self.budget.cost[candidates]))
        return totals

    def time_of(self, chosen: Index) -> float:
        """Time that a plan takes, s."""
        readings = 0.0 if self.time is None else float(self.time.cost[chosen].sum())
        mounting = 0.0 if self.setups is None else self.setups.mounting_time(chosen)
        return readings + mounting

    def additions(self, chosen: Index, count: int) -> Mask:
        """Which of the candidates (C,) may join a plan."""
        free = np.ones(count, dtype=bool)
        free[chosen] = False
        if self.size is not None and len(chosen) >= self.size:
            return np.zeros(count, dtype=bool)
        if self.setups is not None:
            free &= self.setups.additions(chosen)
        if self.budget is not None:
            more = self.budget.cost
            if self.setups is not None:
                more = more + self.setups.mounting_times(chosen)
            free &= self.budget.allows(self.time_of(chosen) + more)
        if self.distance is not None:
            for member in chosen:
                free &= ~self._too_near(int(member), self.distance)
        if self.quotas is not None:
            free &= self.quotas.additions(chosen)
        return free

    def replacements(self, chosen: Index, position: int, count: int) -> Mask:
        """Which of the candidates (C,) may take a place in a plan."""
        remaining = np.delete(chosen, position)
        free = self.additions(remaining, count)
        if self.quotas is not None:
            free &= self.quotas.replacements(remaining, int(chosen[position]))
        return free

    def allocation(
        self,
        chosen: Index,
        weights: Array | None,
        rng: np.random.Generator | None = None,
    ) -> Array | None:
        """Numbers (G,) in the quotas' classes for completing a plan, nearest to sums of
        weights (C,), varied by a generator. None without quotas, or where it cannot be
        completed.
        """
        if self.quotas is None:
            return None
        if weights is None:
            weights = np.ones(self.quotas.members.shape[1])
        sums = self.quotas.class_sums(weights)
        if rng is not None:
            sums = sums * np.exp(LOG_VARIATION * rng.standard_normal(len(sums)))
        return self.quotas.allocate(sums * (self.quotas.size / sums.sum()), chosen)

    def completions(self, chosen: Index, count: int, allocation: Array | None) -> Mask:
        """Which of the candidates (C,) may join a plan on the way to an allocation."""
        free = self.additions(chosen, count)
        if self.quotas is not None and allocation is not None:
            free &= self.quotas.open_classes(chosen, allocation)
        return free

    def satisfied(self, chosen: Index) -> bool:
        """Whether a plan keeps its quotas; the other rules hold by construction."""
        return self.quotas is None or self.quotas.satisfied(chosen)

    def _too_near(self, member: int, distance: DistanceLimit) -> Mask:
        """Candidates of a member's set-up that are too near to it."""
        near = distance.too_near(member)
        if self.setups is not None:
            near &= self.setups.setup == self.setups.setup[member]
        return near

    def subset(self, pool: Index) -> Rules:
        """The rules over a part of the candidates."""
        return dataclasses.replace(
            self,
            time=None if self.time is None else self.time.subset(pool),
            setups=None if self.setups is None else self.setups.subset(pool),
            distance=None if self.distance is None else self.distance.subset(pool),
            quotas=None if self.quotas is None else self.quotas.subset(pool),
        )

    # -- plans of any objective --------------------------------------------------------
    def relax(
        self,
        count: int,
        objective: Callable[[Array | None, float], Objective],
        sharpness: Sequence[float],
        tolerance: Callable[[float], float],
    ) -> Relaxation:
        """The relaxation of an objective that is approached ever more sharply.

        Under the number or the budget, whichever is tighter; set-ups are left out.

        objective  of the weights of `count` candidates, or of what they cost (C,), at a
                   sharpness
        tolerance  duality gap at a sharpness
        """
        from oed.design import relaxation

        optima = []
        for total, cost in self.totals(np.arange(count)):
            start = None
            bound = np.inf
            for sharp in sharpness:
                optimum = relaxation.solve(
                    objective(cost, sharp),
                    total,
                    1.0 if cost is None else cost,
                    tolerance(sharp),
                    start,
                )
                start, bound = optimum.weights, min(bound, optimum.bound)
            weights = optimum.weights if cost is None else optimum.weights / cost
            optima.append(dataclasses.replace(optimum, weights=weights, bound=bound))
        return min(optima, key=lambda optimum: optimum.bound)

    def search(
        self,
        evaluator: PlanEvaluator,
        relaxed: Relaxation,
        rng: np.random.Generator,
        rounds: int,
    ) -> Index:
        """The best plan of a local search from greedy plans at each level."""
        from oed.design import search

        levels = range(evaluator.levels)
        starts = [search.select_greedily(evaluator, self, 0.0, k) for k in levels]
        gains = np.maximum(relaxed.gradient, 0.0)
        return search.search(
            evaluator, self, relaxed.weights, gains, starts, rng, rounds
        )

    def quick_plan(
        self,
        blocks: Array,
        criterion: Criterion,
        base: Array,
        starts: Sequence[Index],
        sweeps: int,
    ) -> Index:
        """The best of a greedy plan and some others after a few exchange sweeps.

        blocks  (C, k, n) candidates
        base    (n, n) prior information
        """
        from oed.design import search
        from oed.design.evaluator import CriterionEvaluator

        evaluator = CriterionEvaluator(blocks, criterion, base)
        plans = [*starts, search.select_greedily(evaluator, self, 0.0, level=0)]
        for level in range(evaluator.levels if sweeps else 0):
            plans = [search.improve(evaluator, self, p, level, sweeps) for p in plans]
        return max(plans, key=evaluator.value)

    # -- convex problems that hold every plan ------------------------------------------
    def relaxations(self, count: int) -> Iterator[RelaxedRules]:
        """Convex problems that together hold every plan under the rules: a plan's value
        is at most the largest, over combinations of set-ups, of the least bound by
        number and budget.
        """
        for candidates, mounting in self._combinations(count):
            for total, cost in self.totals(candidates, mounting):
                yield RelaxedRules(candidates, total, cost)

    def _combinations(self, count: int) -> Iterator[tuple[Index, float]]:
        """Candidates of each combination of set-ups, and its time to mount."""
        everything = np.arange(count)
        setups = self.setups
        mounting_counts = (
            setups is not None
            and setups.seconds is not None
            and self.budget is not None
        )
        if setups is None or (setups.most is None and not mounting_counts):
            yield everything, 0.0
            return
        names = setups.mountable
        most = setups.most_of(len(names))
        if number_of_combinations(len(names), most) > MAX_COMBINATIONS:
            yield everything, 0.0
            return
        sizes = range(1, most + 1) if mounting_counts else (most,)
        for candidates, mounting in setups.combinations(names, sizes):
            if self.budget is None or mounting < self.budget.available:
                yield candidates, mounting


def number_of_combinations(setups: int, most: int) -> int:
    """Number of combinations of 1 to `most` out of a number of set-ups."""
    return sum(math.comb(setups, k) for k in range(1, most + 1))
