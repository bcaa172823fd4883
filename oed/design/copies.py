"""Equal candidates counted once, with their number.

Candidates are compared by a hash of their bits, which takes one pass and one sort. Where
two different candidates have the same hash, nothing is merged.
"""

import dataclasses

import numpy as np

from oed.base import Array, Index

PROJECTION_SEED = 20260101  #: seed of the hash's multipliers


@dataclasses.dataclass(frozen=True, eq=False)
class Copies:
    """Kinds of candidates."""

    first: Index  #: (U,) the first candidate of each kind, ascending
    label: Index  #: (C,) kind of each candidate
    number: Index  #: (U,) candidates of each kind

    @property
    def exist(self) -> bool:
        """Whether any two candidates are equal."""
        return len(self.first) < len(self.label)

    def different(self, kinds: Index) -> Index:
        """Different candidates (size,) of the kinds (size,), which may repeat.

        No kind may repeat more often than it has candidates. Copies take turns from kind to
        kind: a plan has all directions of travel that the design does not tell apart.
        """
        if not self.exist:
            return kinds
        by_kind = np.argsort(self.label, kind="stable")
        begin = np.cumsum(self.number) - self.number
        order = np.argsort(kinds, kind="stable")
        ordered = kinds[order]
        repeat = np.arange(len(kinds)) - np.searchsorted(ordered, ordered)
        turn = np.cumsum(np.diff(ordered, prepend=ordered[:1]) > 0)
        copy = (repeat + turn) % self.number[ordered]
        chosen = np.empty_like(kinds)
        chosen[order] = by_kind[begin[ordered] + copy]
        return chosen


def find_copies(candidates: Array) -> Copies:
    """The kinds of candidates (C, n) or blocks (C, k, n)."""
    rows = candidates.reshape(len(candidates), -1)
    _, first, label, number = np.unique(
        _hashes(rows), return_index=True, return_inverse=True, return_counts=True
    )
    if len(first) == len(rows) or not np.array_equal(rows[first[label]], rows):
        everything = np.arange(len(rows))
        return Copies(everything, everything, np.ones_like(everything))
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Copies(first[order], rank[label], number[order])


def _hashes(rows: Array) -> Index:
    """One number (C,) a row, equal for equal rows."""
    generator = np.random.default_rng(PROJECTION_SEED)
    multipliers = generator.integers(1, 2**63, rows.shape[1], dtype=np.uint64)
    bits = np.ascontiguousarray(rows, dtype=float).view(np.uint64)
    return np.asarray(bits @ (2 * multipliers + 1))
