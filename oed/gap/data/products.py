"""Products of the columns of effects and of processes in a metric.

Columns of many readings take much memory once they are whitened: of effects, those that
are needed are whitened alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.gap.data.evidence import Grams, WhitenedColumns
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem


class ColumnProducts:
    """Products of some effects' columns with each other and with all processes'."""

    def __init__(
        self,
        problem: GapProblem,
        metric: Metric,
        effects: Array,
        processes: Array,
        groups: Sequence[Index],
        needed: Index,
    ) -> None:
        """Whiten columns (N, K) of effects and (N, P) of processes.

        groups  choices (a, d) of the processes' columns, whose Gram matrices are wanted
        needed  (E,) numbers of the effects' columns whose products are wanted
        """
        self._effects = WhitenedColumns(problem, metric, effects[:, needed])
        self._place = np.full(effects.shape[1], -1, dtype=np.intp)
        self._place[needed] = np.arange(len(needed))
        #: energy (K,) of each effects' column; 0 of those that are not needed
        self.diagonal = np.zeros(effects.shape[1])
        self.diagonal[needed] = self._effects.diagonal
        self._processes = WhitenedColumns(problem, metric, processes)
        #: energy (P,) of each processes' column, also before the parameters absorb, and
        #: projection (P,) of the residual
        self.process_diagonal = self._processes.diagonal
        self.process_whole = self._processes.whole
        self.process_b = self._processes.b
        #: Gram matrices (a, d, d) of each group
        self.blocks = [self._processes.blocks(group) for group in groups]

    def grams(self, columns: Index) -> Grams:
        """Grams of some of the needed columns, by their numbers among all."""
        return self._effects.grams(self._place[columns])

    def with_processes(self, columns: Index) -> Array:
        """Products (k, P) of some of the needed columns with all processes'."""
        some = self._effects.of(self._place[columns])
        return some.with_others(self._processes)
