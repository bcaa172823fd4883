"""Rules of a plan: number of readings, time, set-ups, distances, and quotas.

Whether a candidate can be read at all (workspace, joint travel, singularity, bar
travel, collisions) is decided earlier (`oed.design.feasible`). These rules hold between
the readings of one plan.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from oed.base.arrays import Array, Index, Mask
from oed.design.quotas import QuotaSet

#: combinations of set-ups that are bounded one by one, at the most
MAX_COMBINATIONS = 64
#: standard deviation of the logarithm of the classes' numbers, where they are varied
VARIATION = 0.5


class RelaxedRules(NamedTuple):
    """A convex problem: weights 0 <= w <= 1 on `candidates` with one sum held.

    The sum is sum w = total, or sum cost w = total where a cost is given.
    """

    candidates: Index
    total: float
    cost: Array | None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rules:
    """Rules of a plan over C candidates; `size` or `budget` is given, or both.

    size          number of candidates to choose; with a budget, at the most
    budget        time available, s
    cost          (C,) time of each candidate, s
    setup         (C,) number of the set-up of each candidate
    setup_cost    (S,) time to mount each set-up, s, paid once
    most_setups   number of set-ups at the most
    position      (C, d) of each candidate, in units of its own
    min_distance  least distance of two chosen candidates of one set-up
    mounted       set-ups that are mounted already: they cost nothing and do not count
    quotas        numbers to take from selections of the candidates; they need `size`,
                  and go neither with a budget nor with `most_setups`
    """

    size: int | None = None
    budget: float | None = None
    cost: Array | None = None
    setup: Index | None = None
    setup_cost: Array | None = None
    most_setups: int | None = None
    position: Array | None = None
    min_distance: float = 0.0
    mounted: tuple[int, ...] = ()
    quotas: QuotaSet | None = None

    def __post_init__(self) -> None:
        if self.size is None and self.budget is None:
            raise ValueError("a plan needs a number of readings or a budget")
        priced = self.cost is not None and (np.asarray(self.cost) > 0).all()
        if self.budget is not None and not priced:
            raise ValueError("a budget needs the positive cost of every candidate")
        about_setups = self.most_setups is not None or self.setup_cost is not None
        if about_setups and self.setup is None:
            raise ValueError("rules about set-ups need the set-up of every candidate")
        if self.min_distance > 0.0 and self.position is None:
            raise ValueError("a least distance needs the position of every candidate")
        if self.quotas is not None:
            free_number = self.budget is not None or self.most_setups is not None
            if free_number or self.size != self.quotas.size:
                raise ValueError("quotas need the number of readings, and no budget")

    @property
    def only_size(self) -> bool:
        """Whether the number of candidates is the only rule."""
        unlimited = self.budget is None and self.most_setups is None
        return unlimited and self.min_distance <= 0.0 and self.quotas is None

    @property
    def mountable(self) -> Index:
        """Set-ups that are not mounted yet."""
        assert self.setup is not None
        return np.setdiff1d(self.setup, np.array(self.mounted, dtype=np.intp))

    def totals(self, count: int) -> list[tuple[float, Array | None]]:
        """Sums that the weights, or their costs, are held to: (total, cost or None).

        The time to mount is left out, which only raises a bound.
        """
        totals: list[tuple[float, Array | None]] = []
        if self.size is not None:
            totals.append((float(min(self.size, count)), None))
        if self.budget is not None and self.cost is not None:
            totals.append((float(min(self.budget, self.cost.sum())), self.cost))
        return totals

    def time_of(self, chosen: Index) -> float:
        """Time that a plan takes, s."""
        readings = 0.0 if self.cost is None else float(self.cost[chosen].sum())
        return readings + self._mounting_time(chosen)

    def _mounting_time(self, chosen: Index) -> float:
        if self.setup is None or self.setup_cost is None:
            return 0.0
        return float(self.setup_cost[self._setups_to_mount(chosen)].sum())

    def _setups_to_mount(self, chosen: Index) -> Index:
        assert self.setup is not None
        return np.setdiff1d(self.setup[chosen], np.array(self.mounted, dtype=np.intp))

    def additions(self, chosen: Index, count: int) -> Mask:
        """Which of the candidates (C,) may join a plan."""
        free = np.ones(count, dtype=bool)
        free[chosen] = False
        if self.size is not None and len(chosen) >= self.size:
            return np.zeros(count, dtype=bool)
        needs_setup = self._needs_setup(chosen, count)
        if self._setups_used_up(chosen):
            free &= ~needs_setup
        if self.budget is not None:
            free &= self._affordable(chosen, needs_setup)
        if self.min_distance > 0.0:
            for member in chosen:
                free &= ~self._too_near(int(member))
        if self.quotas is not None:
            free &= self.quotas.additions(chosen)
        return free

    def replacements(self, chosen: Index, place: int, count: int) -> Mask:
        """Which of the candidates (C,) may take a place in a plan."""
        remaining = np.delete(chosen, place)
        free = self.additions(remaining, count)
        if self.quotas is not None:
            free &= self.quotas.replacements(remaining, int(chosen[place]))
        return free

    def allocation(
        self,
        chosen: Index,
        weights: Array | None,
        rng: np.random.Generator | None = None,
    ) -> Array | None:
        """Numbers (G,) in the quotas' classes for completing a plan.

        The numbers are nearest to the sums of weights (C,), even ones by default; a
        generator varies the sums. None without quotas, or where the plan cannot be
        completed.
        """
        if self.quotas is None:
            return None
        if weights is None:
            weights = np.ones(self.quotas.members.shape[1])
        sums = self.quotas.class_sums(weights)
        if rng is not None:
            sums = sums * np.exp(VARIATION * rng.standard_normal(len(sums)))
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

    def _setups_used_up(self, chosen: Index) -> bool:
        """Whether no further set-up may be mounted."""
        if self.most_setups is None:
            return False
        return len(self._setups_to_mount(chosen)) >= self.most_setups

    def _affordable(self, chosen: Index, needs_setup: Mask) -> Mask:
        """Candidates that the remaining budget pays for."""
        assert self.cost is not None
        assert self.budget is not None
        more = self.cost.copy()
        if self.setup_cost is not None:
            assert self.setup is not None
            more = more + np.where(needs_setup, self.setup_cost[self.setup], 0.0)
        return self.time_of(chosen) + more <= self.budget * (1 + 1e-12)

    def _needs_setup(self, chosen: Index, count: int) -> Mask:
        """Candidates whose set-up is not mounted yet."""
        if self.setup is None:
            return np.zeros(count, dtype=bool)
        mounted = np.array(self.mounted, dtype=np.intp)
        return ~np.isin(self.setup, np.append(self._setups_to_mount(chosen), mounted))

    def _too_near(self, member: int) -> Mask:
        """Candidates of the same set-up nearer to a member than `min_distance`."""
        assert self.position is not None
        distance = np.linalg.norm(self.position - self.position[member], axis=1)
        near = distance < self.min_distance * (1 - 1e-9)
        if self.setup is not None:
            near &= self.setup == self.setup[member]
        return np.asarray(near)

    def subset(self, pool: Index) -> Rules:
        """The rules over a part of the candidates."""
        return dataclasses.replace(
            self,
            cost=None if self.cost is None else self.cost[pool],
            setup=None if self.setup is None else self.setup[pool],
            position=None if self.position is None else self.position[pool],
            quotas=None if self.quotas is None else self.quotas.subset(pool),
        )

    # -- convex problems that hold every plan ------------------------------------------

    def relaxations(self, count: int) -> Iterator[RelaxedRules]:
        """Convex problems that together hold every plan under the rules.

        A first level runs over combinations of set-ups, or over all set-ups at once
        where there are too many combinations. The second level holds the number and
        the budget. A plan's value is at most the largest, over the first level, of the
        smallest bound over the second.
        """
        for candidates, mounting in self._combinations(count):
            if self.size is not None:
                total = float(min(self.size, len(candidates)))
                yield RelaxedRules(candidates, total, None)
            if self.budget is not None:
                assert self.cost is not None
                cost = self.cost[candidates]
                total = float(min(self.budget - mounting, cost.sum()))
                yield RelaxedRules(candidates, total, cost)

    def _combinations(self, count: int) -> Iterator[tuple[Index, float]]:
        """Candidates of each combination of set-ups, and its time to mount."""
        everything = np.arange(count)
        mounting_counts = self.setup_cost is not None and self.budget is not None
        if self.setup is None or (self.most_setups is None and not mounting_counts):
            yield everything, 0.0
            return
        names = self.mountable
        most = min(self.most_setups or len(names), len(names))
        if number_of_combinations(len(names), most) > MAX_COMBINATIONS:
            yield everything, 0.0
            return
        sizes = range(1, most + 1) if mounting_counts else (most,)
        for size in sizes:
            for combination in itertools.combinations(names, size):
                allowed = [*combination, *self.mounted]
                candidates = np.flatnonzero(np.isin(self.setup, allowed))
                mounting = 0.0
                if self.setup_cost is not None:
                    mounting = float(self.setup_cost[list(combination)].sum())
                if self.budget is None or mounting < self.budget:
                    yield candidates, mounting


def number_of_combinations(setups: int, most: int) -> int:
    """Number of combinations of 1 to `most` out of a number of set-ups."""
    return sum(math.comb(setups, k) for k in range(1, most + 1))
