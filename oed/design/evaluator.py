"""Values of plans, and of plans with each candidate added, for exchange searches."""

import dataclasses
from typing import Protocol

import numpy as np

from oed.base import Array, Index
from oed.design import tabu
from oed.design.blocks import information
from oed.design.forms import Criterion

#: ridge that keeps singular plans finite, as a share of the mean eigenvalue
SMALL_RIDGE = 1e-12
#: rows of the candidates that a search by pairs runs over: as many as a step has time for
PAIR_ROWS = 4000


class PlanEvaluator(Protocol):
    """Values of plans as log phi.

    A level is a step of the criterion's continuation; the last level is the criterion
    itself.
    """

    @property
    def count(self) -> int:
        """Number of candidates."""
        ...

    @property
    def levels(self) -> int:
        """Number of levels."""
        ...

    def value(self, chosen: Index) -> float:
        """Value of a plan by the criterion; -inf where a direction is undetermined."""
        ...

    def regularised_value(self, chosen: Index, level: int) -> float:
        """Value of a plan at a level, with the ridge of `values_after_adding`."""
        ...

    def values_after_adding(
        self, chosen: Index, level: int, ridge: float | None = None
    ) -> Array:
        """Values (C,) with each candidate added; -inf off a shortlist."""
        ...

    @property
    def pair_pool(self) -> int:
        """Candidates that a search by pairs runs over; 0 where there are no pairs."""
        return 0

    def exchange_pairs(self, chosen: Index, level: int, sweeps: int) -> Index:
        """The plan after as many exchanges of pairs as so many sweeps have."""
        return chosen

    def tabu_search(self, starts: Index, steps: int, rng: np.random.Generator) -> Index:
        """The best plan from starts (plans, size) by a search, or the first."""
        return np.asarray(starts[0])

    def subset(self, pool: Index) -> "PlanEvaluator":
        """The evaluator over a part of the candidates."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class CriterionEvaluator:
    """One criterion of M0 + sum X_i^T X_i, for blocks (C, k, n) and M0 `base` (n, n)."""

    blocks: Array
    criterion: Criterion
    base: Array

    @property
    def count(self) -> int:
        """Number of candidates."""
        return len(self.blocks)

    @property
    def levels(self) -> int:
        """Number of levels of the continuation."""
        return len(self.criterion.continuation())

    def _matrix(self, chosen: Index, ridge: float | None) -> Array:
        # summed anew each time: taking a block out of a sum would lose digits
        m = self.base + information(self.blocks[chosen])
        size = SMALL_RIDGE * float(np.trace(m)) / len(m) if ridge is None else ridge
        return m + size * np.eye(len(m))

    def value(self, chosen: Index) -> float:
        """log phi of a plan."""
        return self.criterion.value(self.base + information(self.blocks[chosen]))

    def regularised_value(self, chosen: Index, level: int) -> float:
        """Value of a plan at a level."""
        criterion = self.criterion.continuation()[level]
        return criterion.value(self._matrix(chosen, None))

    def values_after_adding(
        self, chosen: Index, level: int, ridge: float | None = None
    ) -> Array:
        """Value at a level with each candidate added (C,)."""
        criterion = self.criterion.continuation()[level]
        return criterion.values_after_adding(self._matrix(chosen, ridge), self.blocks)

    @property
    def pair_pool(self) -> int:
        """As many as have `PAIR_ROWS`."""
        return PAIR_ROWS // int(self.blocks.shape[1])

    def exchange_pairs(self, chosen: Index, level: int, sweeps: int) -> Index:
        """Exchange of pairs by formulas of low rank."""
        criterion = self.criterion.continuation()[level]
        exchanges = sweeps * len(chosen)
        base = self._base_with_ridge(chosen)
        return tabu.exchange_pairs(self.blocks, chosen, base, criterion, exchanges)

    def tabu_search(self, starts: Index, steps: int, rng: np.random.Generator) -> Index:
        """Tabu search."""
        base = self._base_with_ridge(starts[0])
        return tabu.search_plans(self.blocks, starts, base, self.criterion, steps, rng)

    def _base_with_ridge(self, chosen: Index) -> Array:
        """Prior information (n, n) that keeps singular plans finite."""
        size = float(np.trace(self.base + information(self.blocks[chosen])))
        n = len(self.base)
        return self.base + SMALL_RIDGE * size / n * np.eye(n)

    def subset(self, pool: Index) -> "CriterionEvaluator":
        """The evaluator over a part of the candidates."""
        return dataclasses.replace(self, blocks=self.blocks[pool])

    def ridge(self) -> float:
        """Ridge for the undetermined directions while a plan is begun."""
        return 1e-9 * float(np.mean(np.sum(self.blocks**2, axis=(1, 2))))
