"""The best plan of all, proven: branch and bound for small cases.

A node has candidates taken and candidates left out; the relaxation over the rest bounds
every plan below it. The node with the highest bound is split at the candidate whose
weight is least decided. Candidates that no better plan can hold are left out on the way
(`oed.design.relaxation.eliminated`), which is what makes dozens of candidates few.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools

import numpy as np

from oed.arrays import Array, Index
from oed.design import exchange, relaxation
from oed.design.blocks import as_blocks, information, seen
from oed.design.certificate import SAFE
from oed.design.criterion import Criterion, named
from oed.design.objective import Plain

#: nodes looked at, at the most
NODES = 2000
#: log phi within which two plans count as equally good
EQUAL = 1e-9


@dataclasses.dataclass(frozen=True)
class Proven:
    """The best plan found, and what is known of it.

    indices ascending; value and bound as log phi; `optimal` where no plan is better (by
    more than rounding)
    """

    indices: Index
    value: float
    bound: float
    optimal: bool
    nodes: int


@dataclasses.dataclass(frozen=True, eq=False)
class _Node:
    taken: Index
    open: Index


def solve(
    rows: Array,
    size: int,
    rng: np.random.Generator,
    criterion: Criterion | str = "D",
    prior: Array | None = None,
    nodes: int = NODES,
    start: Index | None = None,
) -> Proven:
    """The best `size` candidates of rows (C, n) or blocks (C, k, n) by a smooth
    criterion.

    Starts from the exchange's plan, or from `start`. Stops after `nodes` nodes with the
    best plan and a valid bound. Raises ValueError for criteria that are not smooth and
    concave, and as `exchange.choose`.
    """
    blocks = as_blocks(rows)
    wanted = (
        named(criterion, blocks.shape[2]) if isinstance(criterion, str) else criterion
    )
    if not (wanted.smooth and wanted.concave):
        raise ValueError(
            f"branch and bound needs a smooth, concave criterion, not {wanted.name}"
        )
    if start is None:
        start = exchange.choose(blocks, size, rng, wanted, prior).indices
    blocks, basis = seen(blocks, prior)
    base = (
        np.zeros((blocks.shape[2],) * 2) if prior is None else basis.T @ prior @ basis
    )
    return _Tree(blocks, wanted.within(basis), base, size).run(np.sort(start), nodes)


@dataclasses.dataclass(eq=False)
class _Tree:
    blocks: Array
    criterion: Criterion
    base: Array
    size: int

    def run(self, best: Index, nodes: int) -> Proven:
        """Best first."""
        value = self.value(best)
        ticket = itertools.count()
        root = _Node(np.zeros(0, dtype=np.intp), np.arange(len(self.blocks)))
        heap: list[tuple[float, int, _Node]] = [(-np.inf, next(ticket), root)]
        looked = 0
        while heap and looked < nodes and -heap[0][0] > value + EQUAL:
            _, _, node = heapq.heappop(heap)
            looked += 1
            bound, weights, left = self.bounded(node, value)
            if bound <= value + EQUAL:
                continue
            plan = np.sort(
                np.concatenate(
                    [
                        node.taken,
                        left[np.argsort(-weights, kind="stable")][: self.missing(node)],
                    ]
                )
            )
            reached = self.value(plan)
            if reached > value:
                best, value = plan, reached
            for child in self.split(node, left, weights):
                heapq.heappush(heap, (-bound, next(ticket), child))
        above = max([value, *(-b for b, _, _ in heap)])
        return Proven(
            best.astype(np.intp), value, above, above <= value + EQUAL, looked
        )

    def value(self, chosen: Index) -> float:
        """log phi of a plan."""
        return self.criterion.value(self.base + information(self.blocks[chosen]))

    def missing(self, node: _Node) -> int:
        """Readings still to choose."""
        return self.size - len(node.taken)

    def bounded(self, node: _Node, value: float) -> tuple[float, Array, Index]:
        """Bound of the plans below a node, the weights that attain it, and the
        candidates still open.
        """
        missing = self.missing(node)
        if missing == 0 or missing >= len(node.open):
            whole = np.concatenate([node.taken, node.open[:missing]])
            return self.value(whole), np.ones(len(node.open)), node.open
        held = Plain(
            self.criterion,
            self.blocks[node.open],
            self.base + information(self.blocks[node.taken]),
        )
        found = relaxation.solve(held, float(missing), 1.0, 1e-7)
        active = np.flatnonzero(found.weights > 0)
        line = held.line(active, found.weights[active])
        caps = np.ones(len(node.open))
        gone = relaxation.eliminated(line, value + EQUAL - SAFE, float(missing), caps)
        kept = np.setdiff1d(np.arange(len(node.open)), gone)
        if len(kept) < missing:
            return -np.inf, found.weights, node.open
        return found.bound, found.weights[kept], node.open[kept]

    def split(self, node: _Node, left: Index, weights: Array) -> list[_Node]:
        """With and without the candidate whose weight is nearest to a half."""
        if self.missing(node) == 0 or self.missing(node) >= len(left):
            return []
        middle = int(np.argmin(np.abs(weights - 0.5)))
        rest = np.delete(left, middle)
        return [
            _Node(np.append(node.taken, left[middle]), rest),
            _Node(node.taken, rest),
        ]
