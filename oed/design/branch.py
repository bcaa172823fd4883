"""Branch and bound: the best plan with a proof, for small cases.

A node has some candidates taken and some excluded; the relaxation over the others
bounds every plan below it. The node with the highest bound is split at the candidate
whose weight is nearest to a half. Candidates that no better plan can hold are excluded
on the way (`oed.design.relaxation.eliminate`), which makes dozens of candidates few.
"""

import dataclasses
import heapq
import itertools

import numpy as np

from oed.base import Array, Index
from oed.design import exchange, relaxation
from oed.design.blocks import block_array, information, project_on_estimable
from oed.design.catalogue import CRITERIA
from oed.design.exchange import Choice
from oed.design.forms import Criterion
from oed.design.objective import LOG_ROUNDING, CriterionObjective

MAX_NODES = 2000  #: nodes visited, at the most
#: two plans whose log phi differs by less than this are equally good
EQUAL_TOLERANCE = 1e-9
NODE_TOLERANCE = 1e-7  #: duality gap of a node's relaxation, in log phi


@dataclasses.dataclass(frozen=True)
class BranchResult:
    """The best plan of a tree, and its certificate."""

    indices: Index  #: chosen candidates, ascending
    value: float  #: log phi of the plan
    bound: float  #: log phi of no plan exceeds it
    nodes: int  #: nodes visited


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
    nodes: int = MAX_NODES,
    start: Index | None = None,
) -> BranchResult:
    """The best `size` candidates of rows (C, n) or blocks (C, k, n).

    Starts from the plan of the exchange, or from `start`. Stops after `nodes` nodes
    with the best plan and a valid bound. Raises ValueError for a criterion that is not
    smooth and concave, and as `exchange.choose`.
    """
    blocks = block_array(rows)
    goal = criterion
    if isinstance(goal, str):
        goal = CRITERIA.build(goal, blocks.shape[2])
    if not (goal.smooth and goal.concave):
        raise ValueError(
            f"branch and bound needs a smooth, concave criterion, not {goal.name}"
        )
    if start is None:
        start = exchange.choose(blocks, size, rng, goal, prior=prior).indices
    blocks, basis = project_on_estimable(blocks, prior)
    base = np.zeros((blocks.shape[2],) * 2)
    if prior is not None:
        base = basis.T @ prior @ basis
    tree = _Tree(CriterionObjective(goal.restrict(basis), blocks, base), size)
    return tree.search(np.sort(start), nodes)


def tighten(
    choice: Choice,
    rows: Array,
    rng: np.random.Generator,
    criterion: Criterion,
    prior: Array | None,
    nodes: int,
) -> Choice:
    """A choice with the bound, and perhaps the better plan, of `nodes` nodes.

    Only for a choice whose number of readings was the only rule. Raises as `solve`.
    """
    size = len(choice.indices)
    result = solve(rows, size, rng, criterion, prior, nodes, choice.indices)
    _, basis = project_on_estimable(block_array(rows), prior)
    goal = criterion.restrict(basis)
    better = dataclasses.replace(
        choice,
        indices=result.indices,
        value=goal.conventional_value(result.value, size),
    )
    return better.add_bound(goal, result.value, result.bound, choice.duality_gap)


@dataclasses.dataclass(eq=False)
class _Tree:
    objective: CriterionObjective
    size: int

    def search(self, best: Index, most_nodes: int) -> BranchResult:
        """Visits the node with the highest bound first."""
        value = self.objective.value_of(best)
        ticket = itertools.count()
        root = _Node(np.zeros(0, dtype=np.intp), np.arange(self.objective.count))
        heap: list[tuple[float, int, _Node]] = [(-np.inf, next(ticket), root)]
        visited = 0
        while heap and visited < most_nodes and -heap[0][0] > value + EQUAL_TOLERANCE:
            _, _, node = heapq.heappop(heap)
            visited += 1
            bound, weights, open_candidates = self._bound(node, value)
            if bound <= value + EQUAL_TOLERANCE:
                continue
            plan = self._round(node, weights, open_candidates)
            plan_value = self.objective.value_of(plan)
            if plan_value > value:
                best, value = plan, plan_value
            for child in self._split(node, open_candidates, weights):
                heapq.heappush(heap, (-bound, next(ticket), child))
        bounds = [-negative_bound for negative_bound, _, _ in heap]
        bound = max([value, *bounds])
        return BranchResult(best.astype(np.intp), value, bound, visited)

    def _missing(self, node: _Node) -> int:
        return self.size - len(node.taken)

    def _bound(self, node: _Node, value: float) -> tuple[float, Array, Index]:
        """Bound of the plans below a node, and its weights on the open candidates."""
        missing = self._missing(node)
        if missing == 0 or missing >= len(node.open):
            only_plan = np.concatenate([node.taken, node.open[:missing]])
            value = self.objective.value_of(only_plan)
            return value, np.ones(len(node.open)), node.open
        taken = information(self.objective.blocks[node.taken])
        objective = dataclasses.replace(
            self.objective.subset(node.open), base=self.objective.base + taken
        )
        optimum = relaxation.solve(objective, float(missing), 1.0, NODE_TOLERANCE)
        active = np.flatnonzero(optimum.weights > 0)
        tangent = objective.tangent(active, optimum.weights[active])
        caps = np.ones(len(node.open))
        better = value + EQUAL_TOLERANCE - LOG_ROUNDING
        excluded = relaxation.eliminate(tangent, better, float(missing), caps)
        remaining = np.setdiff1d(np.arange(len(node.open)), excluded)
        if len(remaining) < missing:
            return -np.inf, optimum.weights, node.open
        return optimum.bound, optimum.weights[remaining], node.open[remaining]

    def _round(self, node: _Node, weights: Array, open_candidates: Index) -> Index:
        """The plan of the taken candidates and the heaviest open ones."""
        heaviest = np.argsort(-weights, kind="stable")[: self._missing(node)]
        return np.sort(np.concatenate([node.taken, open_candidates[heaviest]]))

    def _split(
        self, node: _Node, open_candidates: Index, weights: Array
    ) -> list[_Node]:
        """With and without the candidate whose weight is nearest to a half."""
        missing = self._missing(node)
        if missing == 0 or missing >= len(open_candidates):
            return []
        undecided = int(np.argmin(np.abs(weights - 0.5)))
        others = np.delete(open_candidates, undecided)
        taken = np.append(node.taken, open_candidates[undecided])
        return [_Node(taken, others), _Node(node.taken, others)]
