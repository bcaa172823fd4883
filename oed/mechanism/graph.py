"""An SX function as a graph of values, with the operation of each in NumPy and in C."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from oed.base import Array


def twice(x: Array, out: Array) -> None:
    """x + x."""
    np.add(x, x, out=out)


def keep(condition: Array, x: Array, out: Array) -> None:
    """x where the condition holds, 0 elsewhere, also for infinite x and NaN."""
    np.copyto(out, np.where(condition != 0.0, x, 0.0))


class Operation(NamedTuple):
    """What computes a value from others."""

    #: writes its last argument from the others; None for functions of the C library,
    #: whose digits NumPy's own do not share
    array: Callable[..., Any] | None
    expression: str  #: the same in the words of lanes.h


#: by the number of CasADi's instruction; C has sines and cosines of an angle together
OPERATIONS: dict[int, Operation] = {
    ca.OP_ASSIGN: Operation(np.positive, "{0}"),
    ca.OP_NEG: Operation(np.negative, "-{0}"),
    ca.OP_TWICE: Operation(twice, "{0} + {0}"),
    ca.OP_SQ: Operation(np.square, "{0} * {0}"),
    ca.OP_INV: Operation(np.reciprocal, "splat(1.0) / {0}"),
    ca.OP_FABS: Operation(np.abs, "absolute({0})"),
    ca.OP_SQRT: Operation(np.sqrt, "square_root({0})"),
    ca.OP_EXP: Operation(None, "exponential({0})"),
    ca.OP_LOG: Operation(None, "logarithm({0})"),
    ca.OP_SIN: Operation(None, ""),
    ca.OP_COS: Operation(None, ""),
    ca.OP_TAN: Operation(None, "tangent({0})"),
    ca.OP_ASIN: Operation(None, "arcsine({0})"),
    ca.OP_ACOS: Operation(None, "arccosine({0})"),
    ca.OP_ATAN: Operation(None, "arctangent({0})"),
    ca.OP_SINH: Operation(None, "hyperbolic_sine({0})"),
    ca.OP_COSH: Operation(None, "hyperbolic_cosine({0})"),
    ca.OP_TANH: Operation(None, "hyperbolic_tangent({0})"),
    ca.OP_SIGN: Operation(None, "sign({0})"),
    ca.OP_FLOOR: Operation(np.floor, "round_down({0})"),
    ca.OP_CEIL: Operation(np.ceil, "round_up({0})"),
    ca.OP_NOT: Operation(np.logical_not, "truth({0} == splat(0.0))"),
    ca.OP_ADD: Operation(np.add, "{0} + {1}"),
    ca.OP_SUB: Operation(np.subtract, "{0} - {1}"),
    ca.OP_MUL: Operation(np.multiply, "{0} * {1}"),
    ca.OP_DIV: Operation(np.divide, "{0} / {1}"),
    ca.OP_POW: Operation(None, "power({0}, {1})"),
    ca.OP_CONSTPOW: Operation(None, "power({0}, {1})"),
    ca.OP_ATAN2: Operation(None, "direction({0}, {1})"),
    ca.OP_HYPOT: Operation(None, "hypotenuse({0}, {1})"),
    ca.OP_COPYSIGN: Operation(None, "with_sign({0}, {1})"),
    ca.OP_FMIN: Operation(None, "smaller({0}, {1})"),
    ca.OP_FMAX: Operation(None, "larger({0}, {1})"),
    ca.OP_FMOD: Operation(None, "remainder_of({0}, {1})"),
    ca.OP_LT: Operation(np.less, "truth({0} < {1})"),
    ca.OP_LE: Operation(np.less_equal, "truth({0} <= {1})"),
    ca.OP_EQ: Operation(np.equal, "truth({0} == {1})"),
    ca.OP_NE: Operation(np.not_equal, "truth({0} != {1})"),
    ca.OP_AND: Operation(
        np.logical_and, "truth(({0} != splat(0.0)) & ({1} != splat(0.0)))"
    ),
    ca.OP_OR: Operation(
        np.logical_or, "truth(({0} != splat(0.0)) | ({1} != splat(0.0)))"
    ),
    ca.OP_IF_ELSE_ZERO: Operation(keep, "keep({0} != splat(0.0), {1})"),
}


class Node(NamedTuple):
    """A value of the graph."""

    #: number of CasADi's instruction; None for an input's entry and a constant
    operation: int | None
    sources: tuple[int, ...] = ()  #: numbers of the nodes that it takes
    entry: tuple[int, int] | None = None  #: the input and its entry, or None
    constant: float | None = None  #: its number, or None


@dataclasses.dataclass(frozen=True)
class Graph:
    """Values of a dense SX function."""

    nodes: Sequence[Node]  #: sources first
    inputs: Sequence[int]  #: number of entries of each input
    #: for each output, the nodes of its entries, column by column of a matrix
    outputs: Sequence[Sequence[int]]

    def needed(
        self, numbers: Collection[int], computed: Collection[int] = ()
    ) -> set[int]:
        """Nodes that these take values from, and their own; computed ones need no others."""
        needed = set(numbers)
        for number in reversed(range(len(self.nodes))):
            if number in needed and number not in computed:
                needed.update(self.nodes[number].sources)
        return needed

    def varying(self, inputs: Collection[int]) -> set[int]:
        """Nodes that change with these inputs."""
        varying: set[int] = set()
        for number, node in enumerate(self.nodes):
            from_input = node.entry is not None and node.entry[0] in inputs
            if from_input or not varying.isdisjoint(node.sources):
                varying.add(number)
        return varying


def read_graph(function: Any) -> Graph | None:
    """The graph of a dense SX function; None where an instruction is in no table."""
    nodes: list[Node] = []
    outputs = [[0] * function.numel_out(i) for i in range(function.n_out())]
    values: dict[int, int] = {}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            outputs[targets[0]][targets[1]] = values[sources[0]]
            continue
        if code == ca.OP_CONST:
            node = Node(None, constant=float(function.instruction_constant(k)))
        elif code == ca.OP_INPUT:
            node = Node(None, entry=(sources[0], sources[1]))
        elif code in OPERATIONS:
            node = Node(code, tuple(values[source] for source in sources))
        else:
            return None
        nodes.append(node)
        values[targets[0]] = len(nodes) - 1
    inputs = [function.numel_in(i) for i in range(function.n_in())]
    return Graph(nodes, inputs, outputs)
