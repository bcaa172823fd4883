"""C text of an SX function, one statement for each value, over vectors of poses.

The text holds no number of the machine: constants are an array that a call brings along.
So machines that differ in their dimensions alone share it, as those of a campaign do.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterator
from importlib import resources
from typing import NamedTuple

import casadi as ca
import numpy as np

from oed.base import Array
from oed.mechanism.graph import OPERATIONS, Graph, Node

#: operations of one angle that share their work, by the letter of their variable
ANGLE_FUNCTIONS = {ca.OP_SIN: "s", ca.OP_COS: "c"}


class LaneJob(NamedTuple):
    """What is computed of a function.

    template  the file of C text that does it
    varying   numbers of the inputs that vary while the others stay
    macros    further numbers of the template, by name
    """

    template: str
    varying: frozenset[int]
    macros: tuple[tuple[str, int], ...] = ()


@dataclasses.dataclass(frozen=True)
class LaneText:
    """C text, and the constants that its functions take."""

    text: str
    constants: Array


def lane_text(graph: Graph, job: LaneJob) -> LaneText:
    """The C text of a job on the graph of a function."""
    writer = _Writer(graph, job.varying)
    sizes = [len(row) for row in graph.outputs]
    macros = {
        "INPUTS": len(graph.inputs),
        "INPUT_ENTRIES": sum(graph.inputs),
        "OUTPUTS": len(sizes),
        "OUTPUT_ENTRIES": sum(sizes),
        "FIXED_ENTRIES": len(writer.slots),
        **dict(job.macros),
    }
    numbers = ", ".join(map(str, sizes))
    lines = [
        *(f"#define {name} {value}" for name, value in macros.items()),
        _template("lanes.h"),
        f"static const int64_t OUTPUT_SIZES[] = {{{numbers}}};",
        *writer.functions(),
    ]
    if "ROWS" in macros:
        lines.append(_template("elimination.h"))
    lines.append(_template(job.template))
    return LaneText("\n".join(lines), np.array(writer.constants, dtype=float))


@functools.cache
def _template(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


class _Writer:
    """Writes the functions of a graph.

    varying  numbers of the inputs that vary while the others stay

    Attributes:

    constants  numbers of the constants' array
    slots      for each node that varying ones take from fixed ones, its index in `fixed`
    """

    def __init__(self, graph: Graph, varying: Collection[int]) -> None:
        self._graph, self._varied = graph, graph.varying(varying)
        self._starts = np.cumsum([0, *graph.inputs]).tolist()
        nodes = graph.nodes
        self.constants = [n.constant for n in nodes if n.constant is not None]
        numbers = [k for k, n in enumerate(nodes) if n.constant is not None]
        self._constant = {number: index for index, number in enumerate(numbers)}
        self.slots = {number: k for k, number in enumerate(self._shared())}

    def _shared(self) -> list[int]:
        """Computed nodes that stay, of which varying ones take the values."""
        nodes = self._graph.nodes
        sources = {
            source for number in self._varied for source in nodes[number].sources
        }
        return [
            source
            for source in sorted(sources - self._varied)
            if nodes[source].operation is not None
        ]

    def functions(self) -> Iterator[str]:
        """The functions `prepare`, `every_output` and `first_output`."""
        outputs = self._graph.outputs
        every = list(enumerate(n for output in outputs for n in output))
        fixed = [(k, n) for k, n in every if n not in self._varied]
        varied = [(k, n) for k, n in every if n in self._varied]
        first = [(k, n) for k, n in varied if k < len(outputs[0])]
        slots = {f"fixed[{k}]": number for number, k in self.slots.items()}
        results = slots | {f"out[{k}]": number for k, number in fixed}
        yield self._function("prepare", results, (), "vec *restrict fixed")
        pairs = {"every_output": varied, "first_output": first}
        for name, chosen in pairs.items():
            results = {f"out[{k}]": number for k, number in chosen}
            yield self._function(name, results, self.slots, "const vec *fixed")

    def _function(
        self,
        name: str,
        results: dict[str, int],
        computed: Collection[int],
        fixed: str,
    ) -> str:
        """A function that writes results, by variable, from inputs and computed nodes."""
        lines = [
            f"static inline void {name}(const vec *in, const double *constants,"
            f" {fixed}, vec *restrict out)",
            "{",
        ]
        angles: set[int] = set()
        for number in sorted(self._graph.needed(results.values(), computed)):
            node = self._graph.nodes[number]
            if node.operation in ANGLE_FUNCTIONS and number not in computed:
                angle = node.sources[0]
                if angle not in angles:
                    angles.add(angle)
                    lines.append(f"vec s{angle}, c{angle};")
                    lines.append(f"sine_cosine(v{angle}, &s{angle}, &c{angle});")
            value = (
                f"fixed[{self.slots[number]}]"
                if number in computed
                else self._expression(number, node)
            )
            lines.append(f"const vec v{number} = {value};")
        lines += [f"{variable} = v{n};" for variable, n in results.items()]
        return "\n".join([*lines, "}"])

    def _expression(self, number: int, node: Node) -> str:
        """The value of a node, from its sources."""
        if node.constant is not None:
            return f"splat(constants[{self._constant[number]}])"
        if node.entry is not None:
            return f"in[{self._starts[node.entry[0]] + node.entry[1]}]"
        assert node.operation is not None
        if node.operation in ANGLE_FUNCTIONS:
            return f"{ANGLE_FUNCTIONS[node.operation]}{node.sources[0]}"
        sources = [f"v{source}" for source in node.sources]
        return OPERATIONS[node.operation].expression.format(*sources)
