"""Values of plans, and of plans with each candidate added, for exchange searches."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from oed.base import Array, Index
from oed.design import (
    block_exchange,
    block_tabu,
    eigenvalue_tabu,
    row_exchange,
    tabu,
)
from oed.design.blocks import information
from oed.design.forms import Criterion, Variance
from oed.design.forms.protocol import is_positive_definite
from oed.design.row_exchange import RowExchange


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
        """Value at a level of the plan with each candidate added (C,).

        -inf for candidates outside a shortlist.
        """
        ...

    def add_all(self, size: int, level: int, ridge: float) -> Index | None:
        """The greedy plan by a closed formula; None where there is none."""
        return None

    def exchange_all(self, chosen: Index, level: int, sweeps: int) -> Index | None:
        """The plan after all exchanges by a closed formula; None where there is none.

        A formula that goes through the places in turn makes at most so many sweeps.
        """
        return None

    def search_plans(
        self, starts: Index, steps: int, rng: np.random.Generator
    ) -> Index | None:
        """The best plan that starts (plans, size) lead to in some steps of a search.

        None where the evaluator has no search of its own.
        """
        return None

    def subset(self, pool: Index) -> PlanEvaluator:
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
        size = float(np.trace(m)) / len(m) * 1e-12 if ridge is None else ridge
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

    def add_all(self, size: int, level: int, ridge: float) -> Index | None:
        """Rank-one updates, for a mean variance of single rows with a prior."""
        if not self._rows_by_variance:
            return None
        return self._row_exchange(ridge).select_greedily(size)

    def exchange_all(self, chosen: Index, level: int, sweeps: int) -> Index | None:
        """Exchange of pairs for D, of each row in turn for a mean variance."""
        if self._rows_by_variance:
            return self._row_exchange(0.0).exchange(chosen, sweeps)
        if not self._by_determinant:
            return None
        base = self._matrix(chosen, None) - information(self.blocks[chosen])
        if self.blocks.shape[1] == 1:
            return row_exchange.exchange_rows(self.blocks[:, 0], chosen, base)
        return block_exchange.exchange_blocks(self.blocks, chosen, base)

    def search_plans(
        self, starts: Index, steps: int, rng: np.random.Generator
    ) -> Index | None:
        """Tabu search, for D and for E of single rows."""
        size, count = starts.shape[1], self.count
        _, k, directions = self.blocks.shape
        if not directions <= k * size < k * count:
            return None
        if k > 1 and self._by_determinant:
            if size * count * k**2 > block_tabu.MAX_PRODUCTS:
                return None
            base = self._matrix(starts[0], None) - information(self.blocks[starts[0]])
            return block_tabu.search_plans(self.blocks, starts, base, steps, rng)
        if size * count > tabu.MAX_PLACE_CANDIDATES:
            return None
        rows = self.blocks.reshape(-1, directions)
        if self._by_determinant:
            return tabu.search_plans(rows, starts, self.base, steps, rng)
        if self._rows_by_least_eigenvalue:
            return eigenvalue_tabu.search_plans(rows, starts, self.base, steps, rng)
        return None

    @property
    def _by_determinant(self) -> bool:
        """Whether candidates are judged by D of all directions."""
        return self.criterion.fast_search == "volume"

    @property
    def _rows_by_least_eigenvalue(self) -> bool:
        """Whether single rows are judged by the least eigenvalue alone."""
        least = self.criterion.fast_search == "least eigenvalue"
        return least and self.blocks.shape[1] == 1

    @property
    def _rows_by_variance(self) -> bool:
        """Whether single rows are judged by a mean variance that a prior determines."""
        mean = self.criterion.fast_search == "mean variance"
        single = mean and self.blocks.shape[1] == 1
        return single and is_positive_definite(self.base)

    def _row_exchange(self, ridge: float) -> RowExchange:
        assert isinstance(self.criterion, Variance)
        base = self.base + ridge * np.eye(len(self.base))
        return RowExchange(self.blocks[:, 0], self.criterion.factor, base)

    def subset(self, pool: Index) -> CriterionEvaluator:
        """The evaluator over a part of the candidates."""
        return dataclasses.replace(self, blocks=self.blocks[pool])

    def ridge(self) -> float:
        """Ridge for the undetermined directions while a plan is begun."""
        return 1e-9 * float(np.mean(np.sum(self.blocks**2, axis=(1, 2))))
