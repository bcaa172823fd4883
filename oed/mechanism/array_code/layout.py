"""Where the values of an SX function lie as array operations, for any number of points.

Alike values form packs (`oed.mechanism.array_code.packs`). Each pack has a block of rows, one for each
value; a row holds as many numbers as there are points. RowBlocks that are no longer needed
leave their place to others, so that few rows are in use and stay in the processor's
cache.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from oed.mechanism.array_code import packs as packing
from oed.mechanism.array_code.graph import Node, ancestors, read_graph
from oed.mechanism.array_code.packs import ANYWHERE, CONSTANTS, Lane, Row, RowRun

#: least number of rows, one of them taken several times, from which one operation is
#: faster than several; and of rows that are spaced
FEWEST_ROWS, FEWEST_SPACED_ROWS = 4, 8


class Arena:
    """Places of blocks in one piece of memory: what one leaves, the next takes."""

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


class RowBlock(NamedTuple):
    """Rows of a pack: the first in memory, counted in rows of single precision."""

    first: int
    length: int
    double: bool


class Pack(NamedTuple):
    """Values that the same operation computes.

    node   one of them, for its operation
    runs   rows that one call computes, and whether they are all in one piece
    nodes  the numbers of all
    """

    node: Node
    runs: list[tuple[RowRun, bool]]
    nodes: frozenset[int]


class RowBlocks(NamedTuple):
    """Blocks of packs in one piece of memory of `rows` rows of single precision."""

    blocks: list[RowBlock]
    rows: int


class Layout:
    """Packs of a dense SX function and the places of their values.

    varying  number of leading inputs that change between evaluations; all by default
    single   numbers of outputs that single precision suffices for; none by default

    Attributes:

    inputs   number of entries of each input
    outputs  number of entries of each output
    doubles  for each output, whether it is in double precision
    fixed    packs that depend on inputs which do not vary, and their blocks
    varied   packs that vary, and their blocks

    Blocks are numbered: inputs, outputs, those of fixed packs, those of varied ones.
    """

    def __init__(
        self, function: Any, varying: int | None = None, single: Collection[int] = ()
    ) -> None:
        self.inputs = [function.numel_in(i) for i in range(function.n_in())]
        self.outputs = [function.numel_out(i) for i in range(function.n_out())]
        self.doubles = [i not in single for i in range(function.n_out())]
        self.varying = len(self.inputs) if varying is None else varying
        nodes, self._numbers = read_graph(function, self.varying, single)
        self._nodes, packs = packing.group(nodes, self._numbers)
        packs = packing.by_consumers(self._nodes, packs)
        self._rows = self._given_rows()
        self._count = len(self.inputs) + len(self.outputs)
        fixed = [pack for pack in packs if not self._nodes[pack[0]].varies]
        varied = [pack for pack in packs if self._nodes[pack[0]].varies]
        self.fixed_blocks = self._place_all(fixed, lasting=True)
        self.varied_blocks = self._place_all(varied, lasting=False)
        self.fixed = [self._pack(pack) for pack in fixed]
        self.varied = [self._pack(pack) for pack in varied]

    def constants(self, rows: Sequence[Row]) -> list[float | None]:
        """The constants that these rows stand for."""
        return [self._nodes[row.row].constant for row in rows]

    def needed(self, outputs: Collection[int]) -> set[int]:
        """Numbers of the nodes that these outputs need."""
        numbers = [number for i in outputs for number in self._numbers[i]]
        return ancestors(self._nodes, numbers)

    # -- places ------------------------------------------------------------------------

    def _given_rows(self) -> dict[int, Row]:
        """Rows of inputs, constants and outputs, by node."""
        rows = {}
        for number, node in enumerate(self._nodes):
            if node.entry is not None:
                rows[number] = Row(*node.entry)
            elif node.operation is None:
                rows[number] = Row(CONSTANTS, number)
            elif node.output is not None:
                output, entry = node.output
                rows[number] = Row(len(self.inputs) + output, entry)
        return rows

    def _place_all(self, packs: Sequence[Sequence[int]], lasting: bool) -> RowBlocks:
        """Blocks for the packs' values; those that do not last share memory."""
        last = packing.last_uses(self._nodes, packs)
        arena, blocks = Arena(), []
        ending: dict[int, list[tuple[int, int]]] = {}
        for k, pack in enumerate(packs):
            node = self._nodes[pack[0]]
            if node.output is None:
                length = len(pack) * (1 + node.double)
                first = arena.take(length)
                blocks.append(RowBlock(first, len(pack), node.double))
                self._place(pack, lasting)
                ending.setdefault(last[k], []).append((first, length))
            if not lasting:
                for first, length in ending.pop(k, ()):
                    arena.leave(first, length)
        return RowBlocks(blocks, arena.size)

    def _place(self, pack: Sequence[int], lasting: bool) -> None:
        """Give the nodes of a pack the rows of the next block, in the order of runs.

        Those that last, for many evaluations, are in the order of the pack.
        """
        ordered = pack
        if not lasting and len(pack) > 1:
            ordered = [lane.node for run in self._runs(pack) for lane in run.lanes]
        for row, number in enumerate(ordered):
            self._rows[number] = Row(self._count, row)
        self._count += 1

    # -- runs --------------------------------------------------------------------------

    def _pack(self, pack: Sequence[int]) -> Pack:
        runs = [part for run in self._runs(pack) for part in _calls(run)]
        return Pack(self._nodes[pack[0]], runs, frozenset(pack))

    def _runs(self, pack: Sequence[int]) -> list[RowRun]:
        lanes = []
        anywhere = Row(ANYWHERE, 0)
        for number in pack:
            sources = [self._rows[source] for source in self._nodes[number].sources]
            lanes.append(Lane(number, (*sources, self._rows.get(number, anywhere))))
        return packing.runs(lanes)


def _calls(run: RowRun) -> Iterator[tuple[RowRun, bool]]:
    """A run as one call or several, and whether all its rows are in one piece."""
    rows = run.lanes[0].rows
    pairs = zip(rows, run.steps, strict=True)
    whole = all(step == (row.block != CONSTANTS) for row, step in pairs)
    close = all(step in {0, 1} for step in run.steps)
    fewest = FEWEST_ROWS if close else FEWEST_SPACED_ROWS
    if whole or len(run.lanes) >= fewest:
        yield run, whole
        return
    for lane in run.lanes:
        yield RowRun([lane], (0,) * len(rows)), False
