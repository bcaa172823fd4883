"""What exchanges ask of a problem: the value of a plan, and its value after each
candidate is added.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from oed.arrays import Array, Index
from oed.design import fedorov
from oed.design.blocks import information
from oed.design.criterion import Criterion, Determinant


class Judge(Protocol):
    """Values of plans, as log phi. `rungs` lead to the criterion itself, the last one."""

    @property
    def count(self) -> int: ...

    @property
    def rungs(self) -> int: ...

    def value(self, chosen: Index) -> float:
        """Of a plan, by the criterion itself; -inf where it leaves a direction unseen."""
        ...

    def held(self, chosen: Index, rung: int) -> float:
        """Of a plan, by a rung, with the ridge that `added` uses."""
        ...

    def added(self, chosen: Index, rung: int, ridge: float | None = None) -> Array:
        """By a rung, of the plan with each candidate (C,) added; -inf where not worth
        computing.
        """
        ...

    def quick(self, chosen: Index, rung: int) -> Index | None:
        """The plan after all exchanges, where a faster way than one by one is known."""
        ...

    def take(self, pool: Index) -> Judge:
        """Over some of the candidates."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Single:
    """One criterion of M0 + sum X_i^T X_i. The greedy start may be led by another one."""

    blocks: Array
    criterion: Criterion
    base: Array

    @property
    def count(self) -> int:
        """Candidates."""
        return len(self.blocks)

    @property
    def rungs(self) -> int:
        """Steps of the ladder."""
        return len(self.criterion.ladder())

    def _matrix(self, chosen: Index, ridge: float | None) -> Array:
        # summed anew each time: taking a block out of a sum would lose digits
        m = self.base + information(self.blocks[chosen])
        size = float(np.trace(m)) / len(m) * 1e-12 if ridge is None else ridge
        return np.asarray(m + size * np.eye(len(m)))

    def value(self, chosen: Index) -> float:
        """log phi."""
        return self.criterion.value(self.base + information(self.blocks[chosen]))

    def held(self, chosen: Index, rung: int) -> float:
        """By a rung."""
        return self.criterion.ladder()[rung].value(self._matrix(chosen, None))

    def added(self, chosen: Index, rung: int, ridge: float | None = None) -> Array:
        """By a rung, after adding."""
        return self.criterion.ladder()[rung].added(
            self._matrix(chosen, ridge), self.blocks
        )

    def quick(self, chosen: Index, rung: int) -> Index | None:
        """Fedorov's pairs for D of single rows."""
        step = self.criterion.ladder()[rung]
        if (
            not isinstance(step, Determinant)
            or step.interest is not None
            or self.blocks.shape[1] > 1
        ):
            return None
        base = self._matrix(chosen, None) - information(self.blocks[chosen])
        return fedorov.improve(self.blocks[:, 0], chosen, base)

    def take(self, pool: Index) -> Single:
        """Over some of the candidates."""
        return dataclasses.replace(self, blocks=self.blocks[pool])

    def ridge(self) -> float:
        """What stands in for the unseen while a plan is begun."""
        return 1e-9 * float(np.mean(np.sum(self.blocks**2, axis=(1, 2))))
