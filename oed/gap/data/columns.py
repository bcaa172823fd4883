"""Columns of forms, computed where they are asked for: all of long sessions fill gigabytes.

Forms on several carriers, with several factors, share their values: a block of columns
is weights times values, of which one array serves many blocks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index

#: numbers of whole columns that are in memory at once: 32 MB
VALUES_AT_ONCE = 4_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Columns (N, k): weights (N or 1, J) times values (N, J, k), summed over J."""

    weights: Array
    values: Array

    @classmethod
    def of(cls, columns: Array, weights: Array | None = None) -> Block:
        """Columns (N, k), times weights (N, 1) or (1, 1) if there are any."""
        weights = np.ones((1, 1)) if weights is None else weights
        return cls(weights, columns[:, None])

    @property
    def width(self) -> int:
        """Number of its columns."""
        return int(self.values.shape[2])

    def take(self, numbers: Index | slice, rows: slice) -> Array:
        """Some of its columns (n, k) at some rows."""
        weights = self.weights if len(self.weights) == 1 else self.weights[rows]
        values = self.values[rows]
        columns = weights[:, 0, None] * values[:, 0, numbers]
        for j in range(1, values.shape[1]):
            columns += weights[:, j, None] * values[:, j, numbers]
        return np.asarray(columns)


class Columns:
    """Columns (N, K) of blocks, one after the other."""

    def __init__(self, count: int, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self._ends = np.cumsum([0, *(block.width for block in blocks)])
        #: (N, K)
        self.shape = count, int(self._ends[-1])

    @classmethod
    def of(cls, *parts: Array) -> Columns:
        """Of arrays (N, k)."""
        return cls(len(parts[0]), [Block.of(part) for part in parts])

    def __len__(self) -> int:
        return self.shape[0]

    def take(self, numbers: Index, rows: slice = slice(None)) -> Array:
        """Some columns (n, k) at some rows, all by default."""
        count = len(range(*rows.indices(len(self))))
        columns = np.empty((count, len(numbers)))
        owner = np.searchsorted(self._ends, numbers, side="right") - 1
        for k in np.unique(owner):
            own = np.flatnonzero(owner == k)
            within = numbers[own] - self._ends[k]
            columns[:, own] = self.blocks[k].take(within, rows)
        return columns

    def all(self, rows: slice = slice(None)) -> Array:
        """All columns (n, K) at some rows, all by default."""
        return self.take(np.arange(self.shape[1]), rows)

    def with_blocks(self, *further: Block) -> Columns:
        """These columns, and those of further blocks."""
        return Columns(len(self), [*self.blocks, *further])

    def some(self, numbers: Index, factor: float) -> Columns:
        """Some columns times a factor, in this order."""
        owner = np.searchsorted(self._ends, numbers, side="right") - 1
        parts = np.split(numbers, np.flatnonzero(np.diff(owner)) + 1)
        blocks = []
        for part in parts if len(numbers) else ():
            k = int(np.searchsorted(self._ends, part[0], side="right")) - 1
            block, within = self.blocks[k], part - self._ends[k]
            values = block.values
            if not np.array_equal(within, np.arange(block.width)):
                values = values[:, :, within]
            blocks.append(Block(factor * block.weights, values))
        return Columns(len(self), blocks)

    def first_rows(self, count: int) -> Columns:
        """The columns at the first rows alone."""
        blocks = [
            Block(block.weights[:count], block.values[:count]) for block in self.blocks
        ]
        return Columns(count, blocks)

    def products(self, left: Array) -> Array:
        """L^T Y (k, K), for L (N, k)."""
        parts = [np.zeros((left.shape[1], 0))]
        for block in self.blocks:
            terms = zip(block.weights.T, block.values.swapaxes(0, 1), strict=True)
            parts.append(sum((left * w[:, None]).T @ values for w, values in terms))
        return np.hstack(parts)
