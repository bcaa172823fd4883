"""How many readings: predicted accuracy against their number, with a bound, and the
fewest for a wanted accuracy.

The accuracy of component k is the root mean square sqrt(tr(W_k M^-1)) of what
identification leaves of it over the workspace (W_k = F_k^T F_k). Each point of the
curve is a plan made for all components together (G over components, each in units of
the wanted or of a typical accuracy); each bound is of one component alone: no plan of
as many readings is better in it, not even one made for it.

The fewest readings: plans of N readings reach the wanted accuracy, and N is proven the
fewest where already the relaxation of N - 1 readings misses it; else the gap is told.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.design import exchange, relaxation
from oed.design.blocks import as_blocks
from oed.design.criterion import Variance, Worst
from oed.design.rules import Rules


@dataclasses.dataclass(frozen=True, eq=False)
class AccuracyGoal:
    """Components of the pose error: factors (K, r, n) in the columns of the blocks, in
    units of the wanted accuracy.

    A component is reached where its accuracy is at most 1.
    """

    names: tuple[str, ...]
    factors: Array

    def criterion(self) -> Worst:
        """The largest variance, in units of the wanted one."""
        return Worst(self.factors)

    def accuracy(self, m: Array) -> Array:
        """Root mean square (K,) of each component."""
        return np.sqrt(self.criterion().variances(m))


@dataclasses.dataclass(frozen=True, eq=False)
class Point:
    """A plan of `size` readings: accuracy (K,) of each component, and bound (K,) that
    no such plan beats.
    """

    size: int
    indices: Index
    accuracy: Array
    bound: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Fewest:
    """The fewest readings that were found to reach the goal (None: no plan of at most
    `most` does), and the number below which none can. `best` is the last plan;
    `reachable` (K,) the bound at `most` readings.
    """

    size: int | None
    at_least: int
    most: int
    best: Point

    @property
    def proven(self) -> bool:
        """Whether no smaller plan reaches the goal."""
        return self.size is not None and self.size == self.at_least


@dataclasses.dataclass(frozen=True, eq=False)
class SizeCurve:
    """One problem: candidates (C, k, n), information held (n, n), the goal, the rules
    but for the number.
    """

    blocks: Array
    prior: Array
    goal: AccuracyGoal
    rng_seed: tuple[int, ...] = (0,)
    starts: int = 2
    rules: Rules | None = None

    def point(self, size: int) -> Point:
        """A plan of `size` readings."""
        chosen = exchange.choose(
            self.blocks,
            None,
            np.random.default_rng([*self.rng_seed, size]),
            self.goal.criterion(),
            self.prior,
            self.starts,
            certify=False,
            rules=self._rules(size),
        )
        picked = as_blocks(self.blocks)[chosen.indices].reshape(-1, self.prior.shape[0])
        accuracy = self.goal.accuracy(self.prior + picked.T @ picked)
        return Point(size, chosen.indices, accuracy, self.bounds(size))

    def _rules(self, size: int) -> Rules:
        return (
            Rules(size=size)
            if self.rules is None
            else dataclasses.replace(self.rules, size=size)
        )

    def bounds(self, size: int) -> Array:
        """Accuracy (K,) that no plan of `size` readings beats in each component alone."""
        told = []
        for factor in self.goal.factors:
            found = relaxation.relax(
                self.blocks, float(size), self.prior, 1.0, 1e-4, Variance(factor)
            )
            told.append(np.exp(-0.5 * found.bound))
        return np.array(told)

    def curve(self, sizes: Sequence[int]) -> list[Point]:
        """A point for each number of readings; more readings are never worse (a smaller
        plan can be added to).
        """
        return [self.point(n) for n in sizes]

    def fewest(self, most: int, least: int = 1) -> Fewest:
        """The fewest readings whose plan reaches every component's wanted accuracy, by
        bisection.
        """
        at_least = _first(self._reachable, least, most + 1)
        if at_least > most:
            return Fewest(None, most + 1, most, self.point(most))
        low, high, best = at_least, most, self.point(most)
        if (best.accuracy > 1.0).any():
            return Fewest(None, at_least, most, best)
        while low < high:
            middle = (low + high) // 2
            tried = self.point(middle)
            if (tried.accuracy <= 1.0).all():
                high, best = middle, tried
            else:
                low = middle + 1
        return Fewest(best.size, at_least, most, best)

    def _reachable(self, size: int) -> bool:
        """Whether the relaxation leaves room for the goal: by the supporting line of
        all components together.
        """
        worst = self.goal.criterion()
        found = relaxation.relax(self.blocks, float(size), self.prior, 1.0, 1e-3, worst)
        return found.bound >= 0.0


def _first(true: Callable[[int], bool], low: int, high: int) -> int:
    """The first number from low to high for which it is true, if it stays true; `high`
    where it never is.
    """
    while low < high:
        middle = (low + high) // 2
        if true(middle):
            high = middle
        else:
            low = middle + 1
    return low
