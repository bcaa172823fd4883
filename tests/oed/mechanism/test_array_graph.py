"""Graphs and packs of array operations: the graph's values, and orders that it allows."""

import casadi as ca
import numpy as np
import pytest

from oed.mechanism.array_code.graph import Node, ancestors, read_graph
from oed.mechanism.array_code.packs import (
    ANYWHERE,
    Lane,
    Row,
    by_consumers,
    group,
    last_uses,
    runs,
)

A, B = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
#: three legs by one formula, and a value of all of them
LEGS = ca.sqrt(A**2 + ca.sin(B) * A)
FUNCTION = ca.Function("f", [A, B], [LEGS, ca.sum1(LEGS) * 2.0])


def values(nodes: list[Node], inputs: list[np.ndarray]) -> list[float]:
    """Value of each node, one after the other."""
    found: list[float] = []
    for node in nodes:
        if node.constant is not None:
            found.append(node.constant)
        elif node.entry is not None:
            found.append(float(inputs[node.entry[0]][node.entry[1]]))
        else:
            result, sources = np.zeros(1), [np.array([found[s]]) for s in node.sources]
            assert node.operation is not None
            node.operation(*sources, result)
            found.append(float(result[0]))
    return found


def test_a_graph_has_the_functions_values(rng: np.random.Generator) -> None:
    nodes, outputs = read_graph(FUNCTION, 1)
    inputs = [rng.uniform(0.3, 0.9, 3), rng.uniform(0.3, 0.9, 3)]
    found = values(nodes, inputs)
    for row, exact in zip(outputs, FUNCTION(*inputs), strict=True):
        assert [found[k] for k in row] == pytest.approx(np.asarray(exact).ravel())


def test_what_an_input_that_varies_changes_varies() -> None:
    nodes, outputs = read_graph(ca.Function("f", [A, B], [A * 2.0, B * 2.0]), 1)
    assert all(nodes[k].varies for k in outputs[0])
    assert not any(nodes[k].varies for k in outputs[1])


def test_outputs_in_single_precision_leave_the_others_double() -> None:
    nodes, outputs = read_graph(FUNCTION, 2, single=[1])
    assert all(nodes[k].double for k in outputs[0])
    assert not any(nodes[k].double for k in outputs[1])
    # the legs are of the first output, so what they need stays double
    legs = ancestors(nodes, outputs[0])
    assert all(nodes[k].double for k in legs)


def test_ancestors_are_all_that_a_value_needs() -> None:
    nodes = [Node(None), Node(None), Node(np.sqrt, (0,)), Node(np.add, (2, 1))]
    assert ancestors(nodes, [2]) == {0, 2}
    assert ancestors(nodes, [3]) == {0, 1, 2, 3}


def test_alike_values_are_packed_after_what_they_need() -> None:
    nodes, outputs = read_graph(FUNCTION, 2)
    nodes, packs = group(nodes, outputs)
    place = {number: k for k, pack in enumerate(packs) for number in pack}
    computed = {k for k, node in enumerate(nodes) if node.operation is not None}
    assert set(place) == computed
    for k, pack in enumerate(packs):
        assert len({nodes[number].operation for number in pack}) == 1
        needed = {s for number in pack for s in nodes[number].sources} & computed
        assert all(place[source] < k for source in needed)
    assert sorted(len(pack) for pack in packs)[-1] == 3
    assert len({place[number] for number in outputs[0]}) == 1
    users = [
        [
            j
            for j, other in enumerate(packs)
            for n in other
            if set(nodes[n].sources) & set(pack)
        ]
        for pack in packs
    ]
    expected = [max(found, default=k) for k, found in enumerate(users)]
    assert last_uses(nodes, packs) == expected
    sorted_packs = by_consumers(nodes, packs)
    assert [sorted(pack) for pack in sorted_packs] == [sorted(pack) for pack in packs]


def lane(node: int, first: int, second: int) -> Lane:
    return Lane(node, (Row(0, first), Row(1, second), Row(ANYWHERE, 0)))


def test_evenly_spaced_rows_are_one_run() -> None:
    even = [lane(k, 2 * k, 5 + k) for k in range(4)]
    (run,) = runs(even[::-1])
    assert run.steps == (2, 1, 1)
    assert [one.node for one in run.lanes] == [0, 1, 2, 3]


def test_a_gap_between_rows_ends_a_run() -> None:
    split = runs([lane(0, 0, 0), lane(1, 1, 1), lane(2, 5, 2), lane(3, 6, 3)])
    assert [[one.node for one in run.lanes] for run in split] == [[0, 1], [2, 3]]
