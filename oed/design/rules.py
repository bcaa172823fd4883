"""What a plan may be: how many readings or how much time, how many set-ups, how far
apart, and what is kept.

Whether a candidate can be taken at all (workspace, joint travel, singularity, bar
travel, collisions) is decided before (`oed.design.feasible`); here are the rules that
hold between the readings of one plan.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from oed.arrays import Array, Index, Mask

#: combinations of set-ups that are bounded one by one
SUBSETS = 64


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rules:
    """Rules of a plan over C candidates; at least one of `size` and `budget` is given.

    size         number of candidates to choose; with a budget, at the most
    budget       time there is, s; cost (C,) time of each candidate, s
    setup        (C,) number of the set-up of each candidate; setup_cost (S,) time to
                 mount each, s, paid once
    most_setups  set-ups at the most
    place        (C, d) of each candidate, in units of its own; chosen ones are at least
                 `apart` from each other
    taken        set-ups that are mounted already: they cost nothing and do not count
    """

    size: int | None = None
    budget: float | None = None
    cost: Array | None = None
    setup: Index | None = None
    setup_cost: Array | None = None
    most_setups: int | None = None
    place: Array | None = None
    apart: float = 0.0
    taken: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.size is None and self.budget is None:
            raise ValueError("a plan needs a number of readings or a budget")
        if self.budget is not None and (
            self.cost is None or not (np.asarray(self.cost) > 0).all()
        ):
            raise ValueError("a budget needs the positive cost of every candidate")
        if (
            self.most_setups is not None or self.setup_cost is not None
        ) and self.setup is None:
            raise ValueError("rules about set-ups need the set-up of every candidate")
        if self.apart > 0.0 and self.place is None:
            raise ValueError("a least distance needs the place of every candidate")

    @property
    def simple(self) -> bool:
        """Whether only the number counts."""
        return self.budget is None and self.most_setups is None and self.apart <= 0.0

    def totals(self, count: int) -> list[tuple[float, Array | None]]:
        """Sums that the weights of `count` candidates, or what they cost, are held to;
        mounting is left out, which only raises a bound.
        """
        totals: list[tuple[float, Array | None]] = []
        if self.size is not None:
            totals.append((float(min(self.size, count)), None))
        if self.budget is not None and self.cost is not None:
            totals.append((float(min(self.budget, self.cost.sum())), self.cost))
        return totals

    def spent(self, chosen: Index) -> float:
        """Time that a plan takes, s."""
        readings = 0.0 if self.cost is None else float(self.cost[chosen].sum())
        return readings + self._mounting(chosen)

    def _mounting(self, chosen: Index) -> float:
        if self.setup is None or self.setup_cost is None:
            return 0.0
        return float(self.setup_cost[self._mounted(chosen)].sum())

    def _mounted(self, chosen: Index) -> Index:
        assert self.setup is not None
        return np.setdiff1d(self.setup[chosen], np.array(self.taken, dtype=np.intp))

    def allowed(self, chosen: Index, count: int) -> Mask:
        """Candidates (C,) that may join a plan."""
        free = np.ones(count, dtype=bool)
        free[chosen] = False
        if self.size is not None and len(chosen) >= self.size:
            return np.zeros(count, dtype=bool)
        new = self._new(chosen, count)
        if (
            self.most_setups is not None
            and len(self._mounted(chosen)) >= self.most_setups
        ):
            free &= ~new
        if self.budget is not None:
            assert self.cost is not None
            more = self.cost.copy()
            if self.setup_cost is not None:
                assert self.setup is not None
                more = more + np.where(new, self.setup_cost[self.setup], 0.0)
            free &= self.spent(chosen) + more <= self.budget * (1 + 1e-12)
        if self.apart > 0.0:
            assert self.place is not None
            for k in chosen:
                free &= ~self._near(int(k))
        return free

    def _new(self, chosen: Index, count: int) -> Mask:
        """Candidates whose set-up is not mounted yet."""
        if self.setup is None:
            return np.zeros(count, dtype=bool)
        return ~np.isin(
            self.setup,
            np.append(self._mounted(chosen), np.array(self.taken, dtype=np.intp)),
        )

    def _near(self, k: int) -> Mask:
        """Candidates of the same set-up nearer to candidate k than `apart`."""
        assert self.place is not None
        near = np.linalg.norm(self.place - self.place[k], axis=1) < self.apart * (
            1 - 1e-9
        )
        return np.asarray(
            near if self.setup is None else near & (self.setup == self.setup[k])
        )

    def take(self, pool: Index) -> Rules:
        """The rules over some of the candidates."""
        return dataclasses.replace(
            self,
            cost=None if self.cost is None else self.cost[pool],
            setup=None if self.setup is None else self.setup[pool],
            place=None if self.place is None else self.place[pool],
        )

    # -- what a relaxation may spend ---------------------------------------------------

    def limits(self, count: int) -> Iterator[tuple[Index, float, Array | None]]:
        """(candidates, total, cost or None) of convex problems that together hold every
        allowed plan.

        Each is: weights 0 <= w <= 1 on the candidates, with sum w = total, or sum cost
        w = total where a cost is told. A plan's value is at most the largest over the
        first level of the least over the second: one level of combinations of set-ups
        (all of them in one where there are too many), then number and budget.
        """
        for candidates, mounting in self._combinations(count):
            if self.size is not None:
                yield candidates, float(min(self.size, len(candidates))), None
            if self.budget is not None:
                assert self.cost is not None
                cost = self.cost[candidates]
                yield candidates, float(min(self.budget - mounting, cost.sum())), cost

    def _combinations(self, count: int) -> Iterator[tuple[Index, float]]:
        everyone = np.arange(count)
        if self.setup is None or (
            self.most_setups is None
            and (self.setup_cost is None or self.budget is None)
        ):
            yield everyone, 0.0
            return
        names = np.setdiff1d(self.setup, np.array(self.taken, dtype=np.intp))
        most = min(self.most_setups or len(names), len(names))
        if sum(math.comb(len(names), k) for k in range(1, most + 1)) > SUBSETS:
            yield everyone, 0.0
            return
        sizes = (
            range(1, most + 1)
            if self.budget is not None and self.setup_cost is not None
            else (most,)
        )
        for size in sizes:
            for some in itertools.combinations(names, size):
                kept = np.flatnonzero(np.isin(self.setup, [*some, *self.taken]))
                mounting = (
                    0.0
                    if self.setup_cost is None
                    else float(self.setup_cost[list(some)].sum())
                )
                if self.budget is None or mounting < self.budget:
                    yield kept, mounting
