"""Columns of forms, computed where they are asked for: all of long sessions fill gigabytes.

Forms on several carriers, with several factors, share their values: a block of columns
is weights times values, of which one array serves many blocks.
"""

import dataclasses
import functools
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
    def of(cls, columns: Array, weights: Array | None = None) -> "Block":
        """Columns (N, k), times weights (N, 1) if there are any."""
        weights = np.ones((1, 1)) if weights is None else weights
        return cls(weights, columns[:, None])

    @property
    def width(self) -> int:
        """Number of its columns."""
        return int(self.values.shape[2])

    def take(self, numbers: Index, rows: slice) -> Array:
        """Some of its columns (n, k) at some rows."""
        weights = self.weights if len(self.weights) == 1 else self.weights[rows]
        terms = zip(weights.T, self.values[rows].swapaxes(0, 1), strict=True)
        columns = (w[:, None] * values[:, numbers] for w, values in terms)
        return np.asarray(functools.reduce(np.add, columns))


class Columns:
    """Columns (N, K) of blocks, one after the other."""

    def __init__(self, count: int, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self._ends = np.cumsum([0, *(block.width for block in blocks)])
        #: (N, K)
        self.shape = count, int(self._ends[-1])

    def __len__(self) -> int:
        return self.shape[0]

    def _owners(self, numbers: Index) -> Index:
        """Number of the block that each column is of."""
        return np.searchsorted(self._ends, numbers, side="right") - 1

    def take(self, numbers: Index, rows: slice = slice(None)) -> Array:
        """Some columns (n, k) at some rows, all by default."""
        columns = np.empty((len(range(*rows.indices(len(self)))), len(numbers)))
        owner = self._owners(numbers)
        for k in np.unique(owner):
            own = np.flatnonzero(owner == k)
            columns[:, own] = self.blocks[k].take(numbers[own] - self._ends[k], rows)
        return columns

    def all(self, rows: slice = slice(None)) -> Array:
        """All columns (n, K) at some rows, all by default."""
        return self.take(np.arange(self.shape[1]), rows)

    def some(self, numbers: Index, factor: float) -> list[Block]:
        """Some columns times a factor, in this order; whole blocks share their values."""
        owner = self._owners(numbers)
        blocks = []
        for own in np.split(
            np.arange(len(numbers)), np.flatnonzero(np.diff(owner)) + 1
        ):
            k = int(owner[own[0]])
            block = self.blocks[k]
            within = numbers[own] - self._ends[k]
            is_whole = np.array_equal(within, np.arange(block.width))
            values = block.values if is_whole else block.values[:, :, within]
            blocks.append(Block(factor * block.weights, values))
        return blocks

    def first_rows(self, count: int) -> "Columns":
        """The columns at the first rows alone."""
        blocks = [Block(b.weights[:count], b.values[:count]) for b in self.blocks]
        return Columns(count, blocks)

    def products(self, left: Array) -> Array:
        """L^T Y (k, K), for L (N, k)."""
        parts = [np.zeros((left.shape[1], 0))]
        for block in self.blocks:
            terms = zip(block.weights.T, block.values.swapaxes(0, 1), strict=True)
            parts.append(sum((left * w[:, None]).T @ values for w, values in terms))
        return np.hstack(parts)
