"""Memory of blocks that live for a while: what one leaves, the next takes."""

from __future__ import annotations


class Arena:
    """Places of blocks in one piece of memory; first fit."""

    def __init__(self) -> None:
        self.size = 0
        self._free: list[tuple[int, int]] = []

    def take(self, size: int) -> int:
        """First place of a block."""
        for k, (first, length) in enumerate(self._free):
            if length >= size:
                rest = (first + size, length - size)
                self._free[k : k + 1] = [rest] if rest[1] else []
                return first
        first = self.size
        if self._free and sum(self._free[-1]) == self.size:
            first = self._free.pop()[0]
        self.size = first + size
        return first

    def leave(self, first: int, size: int) -> None:
        """Free a block."""
        merged: list[tuple[int, int]] = []
        for begin, length in sorted([*self._free, (first, size)]):
            if merged and sum(merged[-1]) == begin:
                merged[-1] = (merged[-1][0], merged[-1][1] + length)
            else:
                merged.append((begin, length))
        self._free = merged
