"""Predicted accuracy against the number of readings, and the fewest for a goal.

The accuracy of component k is the root mean square sqrt(tr(W_k M^-1)) of the error that
identification leaves over the workspace, W_k = F_k^T F_k. Each point of the curve is a
plan for all components together: G over components, each in units of the wanted or of a
typical accuracy. Each bound is of one component alone: no plan of as many readings is
better in it, even if it serves that component only.

The fewest readings: a plan of N readings reaches the goal. N is proven the fewest where
even the relaxation of N - 1 readings misses it; otherwise a range is reported.
"""

import bisect
import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index
from oed.design import exchange, relaxation
from oed.design.blocks import block_array
from oed.design.forms import LargestVariance, Variance
from oed.design.rules import Rules

#: duality gap of the bounds, in log phi: beyond the digits of a table
BOUND_TOLERANCE = 1e-4
#: duality gap of the goal's feasibility, in log phi: a thousandth of the readings
GOAL_TOLERANCE = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class AccuracyGoal:
    """Wanted accuracy of components of the pose error."""

    names: tuple[str, ...]  #: (K) of the components
    #: (K, r, n) in the blocks' columns, in units of the wanted accuracy; a component is
    #: reached where its accuracy is at most 1
    factors: Array

    def criterion(self) -> LargestVariance:
        """The largest variance, in units of the wanted one."""
        return LargestVariance(self.factors)

    def accuracy(self, m: Array) -> Array:
        """Root mean square (K,) of each component."""
        return np.sqrt(self.criterion().variances(m))


@dataclasses.dataclass(frozen=True, eq=False)
class CurvePoint:
    """A plan on the curve."""

    size: int  #: number of readings
    indices: Index  #: chosen candidates
    accuracy: Array  #: (K,) of each component
    bound: Array  #: (K,) that no plan of this size beats


@dataclasses.dataclass(frozen=True, eq=False)
class FewestReadings:
    """The fewest readings that reach the goal."""

    size: int | None  #: None where no plan of at most `most` readings was found
    at_least: int  #: no plan of fewer readings reaches the goal
    most: int  #: readings that were tried, at the most
    best: CurvePoint  #: the last plan

    @property
    def proven(self) -> bool:
        """Whether no smaller plan reaches the goal."""
        return self.size is not None and self.size == self.at_least


@dataclasses.dataclass(frozen=True, eq=False)
class SizeCurve:
    """Accuracy against the number of readings, for one set of candidates."""

    blocks: Array  #: (C, k, n) candidates
    prior: Array  #: (n, n) prior information
    goal: AccuracyGoal  #: components and their wanted accuracy
    #: of the random numbers; each size draws from (*seed, size), so that a plan does
    #: not depend on which sizes came before
    seed: tuple[int, ...]
    rounds: int = 2  #: rounds of local search
    rules: Rules | None = None  #: of a plan, except for the number

    def point(self, size: int) -> CurvePoint:
        """A plan of `size` readings."""
        rules = Rules(size=size)
        if self.rules is not None:
            rules = dataclasses.replace(self.rules, size=size)
        choice = exchange.choose(
            self.blocks,
            None,
            np.random.default_rng([*self.seed, size]),
            self.goal.criterion(),
            prior=self.prior,
            rounds=self.rounds,
            certify=False,
            rules=rules,
        )
        columns = self.prior.shape[0]
        chosen_rows = block_array(self.blocks)[choice.indices].reshape(-1, columns)
        accuracy = self.goal.accuracy(self.prior + chosen_rows.T @ chosen_rows)
        return CurvePoint(size, choice.indices, accuracy, self.bounds(size))

    def bounds(self, size: int) -> Array:
        """Accuracy (K,) that no plan of `size` readings beats in a component alone."""
        bounds = []
        for factor in self.goal.factors:
            criterion = Variance(factor)
            optimum = relaxation.relax(
                self.blocks, float(size), self.prior, 1.0, BOUND_TOLERANCE, criterion
            )
            bounds.append(np.exp(-0.5 * optimum.bound))
        return np.array(bounds)

    def curve(self, sizes: Sequence[int]) -> list[CurvePoint]:
        """A point for each number of readings."""
        return [self.point(n) for n in sizes]

    def fewest(self, most: int) -> FewestReadings:
        """The fewest readings that reach every component's goal, by bisection."""
        sizes = range(1, most + 1)
        at_least = 1 + bisect.bisect_left(sizes, True, key=self._goal_is_feasible)
        best = self.point(most)
        if at_least > most:
            return FewestReadings(None, most + 1, most, best)
        if (best.accuracy > 1.0).any():
            return FewestReadings(None, at_least, most, best)
        low, high = at_least, most
        while low < high:
            middle = (low + high) // 2
            trial = self.point(middle)
            if (trial.accuracy <= 1.0).all():
                high, best = middle, trial
            else:
                low = middle + 1
        return FewestReadings(best.size, at_least, most, best)

    def _goal_is_feasible(self, size: int) -> bool:
        """Whether the relaxation of all components together reaches the goal."""
        optimum = relaxation.relax(
            self.blocks,
            float(size),
            self.prior,
            1.0,
            GOAL_TOLERANCE,
            self.goal.criterion(),
        )
        return optimum.bound >= 0.0
