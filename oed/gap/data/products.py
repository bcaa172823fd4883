"""Products of the columns of effects and of processes in a metric.

What a search needs of columns that take much memory once they are whitened, of many
readings: no more than one set of them is whitened at a time.
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
        """Whiten columns (N, K) of effects and (N, P) of processes, and multiply them.

        groups  choices (a, d) of the processes' columns, whose Gram matrices are wanted
        needed  (E,) numbers of the effects' columns whose products are wanted
        """
        whitened = WhitenedColumns(problem, metric, effects)
        #: energy (K,) of each effects' column
        self.diagonal = whitened.diagonal
        every = len(needed) == effects.shape[1]
        some = whitened if every else whitened.of(needed)
        self._grams = some.grams()
        self._place = np.full(effects.shape[1], -1, dtype=np.intp)
        self._place[needed] = np.arange(len(needed))
        del whitened  # before the processes' columns take their place
        of_processes = WhitenedColumns(problem, metric, processes)
        #: energy (P,) of each processes' column, also before the parameters absorb, and
        #: projection (P,) of the residual
        self.process_diagonal = of_processes.diagonal
        self.process_whole = of_processes.whole
        self.process_b = of_processes.b
        #: Gram matrices (a, d, d) of each group
        self.blocks = [of_processes.blocks(group) for group in groups]
        self._cross = some.with_others(of_processes)

    def grams(self, columns: Index) -> Grams:
        """Grams of some of the needed columns, by their numbers among all."""
        return self._grams.subset(self._place[columns])

    def with_processes(self, columns: Index) -> Array:
        """Products (k, P) of some of the needed columns with all processes'."""
        return self._cross[self._place[columns]]
