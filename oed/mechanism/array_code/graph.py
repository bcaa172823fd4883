"""An SX function as a graph of array operations, one node for each value.

Some outputs may be in single precision: slopes for Newton's method, say, whose steps
need six digits. What these outputs alone need is then computed in single precision, in
a third to half of the time.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from oed.mechanism.array_code.operations import (
    BINARY,
    UNARY,
    Operation,
    assign,
    copy_bits,
    fill_bits,
    keep_bits,
)


class Node(NamedTuple):
    """A value of the graph.

    operation  what computes it; None for an input's entry and for a constant
    sources    numbers of the nodes that it takes
    entry      the input and its entry, or None
    constant   its number, or None
    varies     whether an input that varies changes it
    double     whether it has double precision, not single
    output     the output and its entry that it is written to, or None
    """

    operation: Operation | None
    sources: tuple[int, ...] = ()
    entry: tuple[int, int] | None = None
    constant: float | None = None
    varies: bool = False
    double: bool = True
    output: tuple[int, int] | None = None


def read_graph(
    function: Any, varying: int, single: Collection[int] = ()
) -> tuple[list[Node], list[list[int]]]:
    """Nodes of a dense SX function, sources first, and the numbers of its outputs' nodes.

    varying  number of leading inputs that vary
    single   numbers of the outputs in single precision
    """
    nodes, outputs = read_nodes(function, range(varying))
    doubles = [entries for i, entries in enumerate(outputs) if i not in single]
    needed = ancestors(nodes, [number for entries in doubles for number in entries])
    precise = _Precise(nodes, needed)
    numbers = [
        [precise.place(number, (i, k), i not in single) for k, number in enumerate(row)]
        for i, row in enumerate(outputs)
    ]
    return precise.nodes, numbers


def ancestors(nodes: Sequence[Node], numbers: Collection[int]) -> set[int]:
    """Numbers of the nodes that these take values from, and their own."""
    needed = set(numbers)
    for number in reversed(range(len(nodes))):
        if number in needed:
            needed.update(nodes[number].sources)
    return needed


def read_nodes(
    function: Any, varying: Collection[int]
) -> tuple[list[Node], list[list[int]]]:
    """Nodes of a function in double precision, and the numbers of its outputs' nodes.

    varying  numbers of the inputs that vary
    """
    nodes: list[Node] = []
    outputs = [[0] * function.numel_out(i) for i in range(function.n_out())]
    values: dict[int, int] = {}
    bits: dict[int, int] = {}
    constants: dict[str, int] = {}

    def add(operation: Operation, *sources: int) -> int:
        varies = any(nodes[source].varies for source in sources)
        nodes.append(Node(operation, sources, varies=varies))
        return len(nodes) - 1

    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            outputs[targets[0]][targets[1]] = values[sources[0]]
            continue
        if code == ca.OP_CONST:
            constant = float(function.instruction_constant(k))
            if constant.hex() not in constants:  # tells 0.0 from -0.0
                nodes.append(Node(None, constant=constant))
                constants[constant.hex()] = len(nodes) - 1
            number = constants[constant.hex()]
        elif code == ca.OP_INPUT:
            entry = (sources[0], sources[1])
            nodes.append(Node(None, entry=entry, varies=sources[0] in varying))
            number = len(nodes) - 1
        elif code == ca.OP_IF_ELSE_ZERO:
            condition, x = (values[source] for source in sources)
            if condition not in bits:
                bits[condition] = add(fill_bits, condition)
            number = add(keep_bits, bits[condition], x)
        elif code == ca.OP_TWICE:
            number = add(BINARY[ca.OP_ADD], values[sources[0]], values[sources[0]])
        elif code in UNARY:
            number = add(UNARY[code], values[sources[0]])
        else:
            number = add(BINARY[code], *(values[source] for source in sources))
        values[targets[0]] = number
    return nodes, outputs


class _Precise:
    """The nodes of a graph with the precision of each, and copies where it changes."""

    def __init__(self, nodes: Sequence[Node], doubles: Collection[int]) -> None:
        self.nodes: list[Node] = []
        self._number: list[int] = []
        self._singles: dict[int, int] = {}
        self._tangents: dict[int, tuple[int, int, int]] = {}
        self._constants: dict[float, int] = {}
        for number, node in enumerate(nodes):
            given = node.operation is None
            double = given or number in doubles
            sources = tuple(self._number[source] for source in node.sources)
            if not double:
                sources = tuple(self._single(source) for source in sources)
            if double and node.operation in {np.sin, np.cos}:
                self._number.append(self._by_half_angle(node.operation, sources[0]))
                continue
            self.nodes.append(node._replace(sources=sources, double=double))
            self._number.append(len(self.nodes) - 1)

    def _by_half_angle(self, operation: Operation, angle: int) -> int:
        """Sine or cosine by t, the tangent of the half angle: 2 t / (1 + t^2), or
        (1 - t^2) / (1 + t^2).

        NumPy has vector code for tangents, six times as fast as its sines.
        """
        if angle not in self._tangents:
            half = self._add(np.multiply, angle, self._constant(0.5))
            tangent = self._add(np.tan, half)
            square = self._add(np.square, tangent)
            denominator = self._add(np.add, square, self._constant(1.0))
            self._tangents[angle] = tangent, square, denominator
        tangent, square, denominator = self._tangents[angle]
        if operation is np.sin:
            numerator = self._add(np.add, tangent, tangent)
        else:
            numerator = self._add(np.subtract, self._constant(1.0), square)
        return self._add(np.divide, numerator, denominator)

    def _add(self, operation: Operation, *sources: int) -> int:
        varies = any(self.nodes[source].varies for source in sources)
        self.nodes.append(Node(operation, sources, varies=varies))
        return len(self.nodes) - 1

    def _constant(self, value: float) -> int:
        if value not in self._constants:
            self.nodes.append(Node(None, constant=value))
            self._constants[value] = len(self.nodes) - 1
        return self._constants[value]

    def _single(self, number: int) -> int:
        """The node of a value in single precision; constants have either."""
        node = self.nodes[number]
        if not node.double or node.constant is not None:
            return number
        if number not in self._singles:
            self._singles[number] = self._copy(number, double=False)
        return self._singles[number]

    def place(self, number: int, output: tuple[int, int], double: bool) -> int:
        """The node that writes a value to an output's entry: its own, or a copy."""
        number = self._number[number]
        node = self.nodes[number]
        given = node.operation is None
        if given or node.output is not None or node.double != double:
            number = self._copy(number, double)
        self.nodes[number] = self.nodes[number]._replace(output=output)
        return number

    def _copy(self, number: int, double: bool) -> int:
        node = self.nodes[number]
        operation = copy_bits if node.operation is fill_bits else assign
        copy = Node(operation, (number,), varies=node.varies, double=double)
        self.nodes.append(copy)
        return len(self.nodes) - 1
