"""Values that the same formula gives, computed together: the legs of a machine, say.

Nodes of a graph are alike where the same operations lead to them, from whichever
entries of the inputs. Alike nodes form a pack. Its values lie in neighbouring rows, so
that one array operation computes several: a run of rows whose sources lie in evenly
spaced rows as well (superword-level parallelism; Larsen and Amarasinghe 2000, PLDI).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from oed.mechanism.array_code.graph import Node, ancestors
from oed.mechanism.array_code.operations import COMMUTATIVE


class Row(NamedTuple):
    """Where a value lies: a row of a block of memory, by their numbers."""

    block: int
    row: int


#: block of constants; their rows are the numbers of their nodes
CONSTANTS = -1
#: block of a result that lies wherever its run is
ANYWHERE = -2


class Lane(NamedTuple):
    """A node of a run with the rows of its sources and, last, of its result."""

    node: int
    rows: tuple[Row, ...]


class RowRun(NamedTuple):
    """Nodes that one array operation can compute.

    lanes  one for each node
    steps  from each row of a lane to that of the next; None for different constants
    """

    lanes: list[Lane]
    steps: tuple[int | None, ...]


def group(
    nodes: Sequence[Node], outputs: Sequence[Sequence[int]]
) -> tuple[list[Node], list[list[int]]]:
    """The nodes, and packs of them in an order of computation.

    Sources of commutative operations are in the same order within a pack. What the
    first output needs comes first, then what the second needs, and so on. Next comes
    what leaves the fewest rows in use.
    """
    nodes, kinds = _kinds(nodes)
    members: dict[int, list[int]] = {}
    for number, kind in enumerate(kinds):
        if nodes[number].operation is not None:
            members.setdefault(kind, []).append(number)
    packs = list(members.values())
    order = _Order(nodes, packs, outputs)
    return nodes, [packs[k] for k in order.all()]


class _Order:
    """An order of packs, by their numbers, each after those that it needs."""

    def __init__(
        self,
        nodes: Sequence[Node],
        packs: Sequence[Sequence[int]],
        outputs: Sequence[Sequence[int]],
    ) -> None:
        pack_of = {number: k for k, pack in enumerate(packs) for number in pack}
        self._stage = [0] * len(packs)
        for i in reversed(range(len(outputs))):
            for number in ancestors(nodes, outputs[i]) & pack_of.keys():
                self._stage[pack_of[number]] = i
        self._needs: list[set[int]] = [set() for _ in packs]
        self._users: list[set[int]] = [set() for _ in packs]
        self._rows = [0] * len(packs)
        for k, pack in enumerate(packs):
            node = nodes[pack[0]]
            if node.output is None:
                self._rows[k] = len(pack) * (1 + node.double)
            sources = {source for number in pack for source in nodes[number].sources}
            self._needs[k] = {pack_of[source] for source in sources & pack_of.keys()}
            for needed in self._needs[k]:
                self._users[needed].add(k)

    def all(self) -> Iterator[int]:
        """Numbers of the packs in their order."""
        missing = [len(needs) for needs in self._needs]
        waiting = [set(users) for users in self._users]
        ready = [k for k, count in enumerate(missing) if not count]

        def rank(k: int) -> tuple[int, int, int]:
            last = [needed for needed in self._needs[k] if waiting[needed] == {k}]
            freed = sum(self._rows[needed] for needed in last)
            return self._stage[k], self._rows[k] - freed, k

        while ready:
            k = min(ready, key=rank)
            ready.remove(k)
            yield k
            for needed in self._needs[k]:
                waiting[needed].discard(k)
            for user in self._users[k]:
                missing[user] -= 1
                if not missing[user]:
                    ready.append(user)


def by_consumers(
    nodes: Sequence[Node], packs: Sequence[Sequence[int]]
) -> list[list[int]]:
    """The packs, in each of them together what the same packs take: x, y, z of legs."""
    consumers: dict[int, list[int]] = {}
    for k, pack in enumerate(packs):
        for number in pack:
            for source in nodes[number].sources:
                consumers.setdefault(source, []).append(k)
    return [sorted(pack, key=lambda n: consumers.get(n, [])) for pack in packs]


def _kinds(nodes: Sequence[Node]) -> tuple[list[Node], list[int]]:
    """Nodes, and a number for each that is the same for those that are alike."""
    numbers: dict[tuple[object, ...], int] = {}
    kinds: list[int] = []
    ordered: list[Node] = []
    for node in nodes:
        if node.operation in COMMUTATIVE:
            sources = tuple(sorted(node.sources, key=kinds.__getitem__))
            node = node._replace(sources=sources)
        output = None if node.output is None else node.output[0]
        given = None if node.entry is None else node.entry[0]
        sources = tuple(kinds[source] for source in node.sources)
        formula = (node.operation, node.double, node.varies, output, given, sources)
        kinds.append(numbers.setdefault(formula, len(numbers)))
        ordered.append(node)
    return ordered, kinds


def runs(lanes: Sequence[Lane]) -> list[RowRun]:
    """The lanes of a pack as few runs."""
    if len(lanes) == 1:
        return _split(lanes)
    count = len(lanes[0].rows) - 1
    options = []
    for order in itertools.permutations(range(count)):
        ranked = sorted(lanes, key=lambda lane: [lane.rows[i] for i in order])
        options.append(_split(ranked))
        if len(options[-1]) == 1:
            break
    return min(options, key=len)


def _split(lanes: Sequence[Lane]) -> list[RowRun]:
    """Lanes in this order as runs, each as long as can be."""
    split: list[RowRun] = []
    for lane in lanes:
        if split:
            last = split[-1]
            steps = _steps(last.lanes[-1], lane)
            if steps is not None and (len(last.lanes) == 1 or steps == last.steps):
                split[-1] = RowRun([*last.lanes, lane], steps)
                continue
        split.append(RowRun([lane], (0,) * len(lane.rows)))
    return split


def _steps(before: Lane, after: Lane) -> tuple[int | None, ...] | None:
    """Steps from the rows of a lane to those of the next; None where there are none."""
    steps: list[int | None] = []
    for first, second in zip(before.rows, after.rows, strict=True):
        step = second.row - first.row
        if first.block != second.block or (step < 0 and first.block >= 0):
            return None
        if first.block == CONSTANTS and step:
            steps.append(None)
        else:
            steps.append(1 if first.block == ANYWHERE else step)
    return tuple(steps)


def last_uses(nodes: Sequence[Node], packs: Sequence[Sequence[int]]) -> list[int]:
    """For each pack, the last that takes values from it: numbers in their order."""
    pack_of = {number: k for k, pack in enumerate(packs) for number in pack}
    last = list(range(len(packs)))
    for k, pack in enumerate(packs):
        for number in pack:
            for source in nodes[number].sources:
                if source in pack_of:
                    last[pack_of[source]] = k
    return last
