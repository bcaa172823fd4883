"""C text of an SX function, one statement for each value, over vectors of poses.

The text holds no number of the machine: constants are an array that a call brings along.
So machines that differ in their dimensions alone share it, as those of a campaign do.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from oed.base.arrays import Array
from oed.mechanism.array_code.graph import Node, ancestors, read_nodes
from oed.mechanism.array_code.operations import Operation, assign, fill_bits, keep_bits

#: expressions of values in the words of lanes.h
EXPRESSIONS: dict[Operation, str] = {
    assign: "{0}",
    np.negative: "-{0}",
    np.square: "{0} * {0}",
    np.reciprocal: "splat(1.0) / {0}",
    np.abs: "absolute({0})",
    np.sqrt: "square_root({0})",
    np.exp: "exponential({0})",
    np.log: "logarithm({0})",
    np.tan: "tangent({0})",
    np.arcsin: "arcsine({0})",
    np.arccos: "arccosine({0})",
    np.arctan: "arctangent({0})",
    np.sinh: "hyperbolic_sine({0})",
    np.cosh: "hyperbolic_cosine({0})",
    np.tanh: "hyperbolic_tangent({0})",
    np.sign: "sign({0})",
    np.floor: "round_down({0})",
    np.ceil: "round_up({0})",
    np.logical_not: "truth({0} == splat(0.0))",
    np.add: "{0} + {1}",
    np.subtract: "{0} - {1}",
    np.multiply: "{0} * {1}",
    np.divide: "{0} / {1}",
    np.power: "power({0}, {1})",
    np.arctan2: "direction({0}, {1})",
    np.hypot: "hypotenuse({0}, {1})",
    np.copysign: "with_sign({0}, {1})",
    np.fmin: "smaller({0}, {1})",
    np.fmax: "larger({0}, {1})",
    np.fmod: "remainder_of({0}, {1})",
    np.less: "truth({0} < {1})",
    np.less_equal: "truth({0} <= {1})",
    np.equal: "truth({0} == {1})",
    np.not_equal: "truth({0} != {1})",
    np.logical_and: "truth(({0} != splat(0.0)) & ({1} != splat(0.0)))",
    np.logical_or: "truth(({0} != splat(0.0)) | ({1} != splat(0.0)))",
    # a condition is a vector of bits here, all set in a lane or none
    fill_bits: "(vec)({0} != splat(0.0))",
    keep_bits: "keep((mask){0}, {1})",
}
#: operations of one angle that share their work
OF_ANGLES = {np.sin: "s", np.cos: "c"}


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


def lane_text(function: Any, job: LaneJob) -> LaneText:
    """The C text of a job on a dense SX function."""
    nodes, outputs = read_nodes(function, job.varying)
    writer = _Writer(nodes, outputs)
    sizes = [function.numel_out(k) for k in range(function.n_out())]
    entries = [function.numel_in(k) for k in range(function.n_in())]
    functions = list(writer.functions(entries))
    macros = {
        "INPUTS": len(entries),
        "INPUT_ENTRIES": sum(entries),
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
        *functions,
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

    Attributes:

    constants  numbers of the constants' array
    slots      for each node that varying ones take from fixed ones, its place in `fixed`
    """

    def __init__(self, nodes: Sequence[Node], outputs: Sequence[Sequence[int]]) -> None:
        self._nodes, self._outputs = nodes, outputs
        self.constants = [n.constant for n in nodes if n.constant is not None]
        numbers = [k for k, n in enumerate(nodes) if n.constant is not None]
        self._constant = {number: place for place, number in enumerate(numbers)}
        self.slots = {number: k for k, number in enumerate(self._shared())}

    def _shared(self) -> list[int]:
        """Computed nodes that stay, of which varying ones take the values."""
        nodes = self._nodes
        sources = {source for node in nodes if node.varies for source in node.sources}
        return [
            source
            for source in sorted(sources)
            if not nodes[source].varies and nodes[source].operation is not None
        ]

    def functions(self, entries: Sequence[int]) -> Iterator[str]:
        """The functions `prepare`, `every_output` and `first_output`.

        entries  numbers of entries of the inputs
        """
        starts = np.cumsum([0, *entries]).tolist()

        def place(node: Node) -> str:
            assert node.entry is not None
            return f"in[{starts[node.entry[0]] + node.entry[1]}]"

        every = [
            (k, number)
            for k, number in enumerate(n for output in self._outputs for n in output)
        ]
        fixed = [(k, n) for k, n in every if not self._nodes[n].varies]
        varied = [(k, n) for k, n in every if self._nodes[n].varies]
        first = [(k, n) for k, n in varied if k < len(self._outputs[0])]
        slots = {f"fixed[{k}]": number for number, k in self.slots.items()}
        results = slots | {f"out[{k}]": number for k, number in fixed}
        yield self._function("prepare", results, set(), place, "vec *restrict fixed")
        pairs = {"every_output": varied, "first_output": first}
        for name, chosen in pairs.items():
            results = {f"out[{k}]": number for k, number in chosen}
            known = set(self.slots)
            yield self._function(name, results, known, place, "const vec *fixed")

    def _function(
        self,
        name: str,
        results: dict[str, int],
        known: Collection[int],
        place: Callable[[Node], str],
        fixed: str,
    ) -> str:
        """A function that writes results, by place, from known nodes and inputs."""
        lines = [
            f"static inline void {name}(const vec *in, const double *constants,"
            f" {fixed}, vec *restrict out)",
            "{",
        ]
        angles: set[int] = set()
        for number in self._needed(results.values(), known):
            node = self._nodes[number]
            if number in known:
                value = f"fixed[{self.slots[number]}]"
            elif node.constant is not None:
                value = f"splat(constants[{self._constant[number]}])"
            elif node.entry is not None:
                value = place(node)
            elif node.operation in OF_ANGLES:
                angle = node.sources[0]
                if angle not in angles:
                    angles.add(angle)
                    lines.append(f"vec s{angle}, c{angle};")
                    lines.append(f"sine_cosine(v{angle}, &s{angle}, &c{angle});")
                value = f"{OF_ANGLES[node.operation]}{angle}"
            else:
                assert node.operation is not None
                sources = [f"v{source}" for source in node.sources]
                value = EXPRESSIONS[node.operation].format(*sources)
            lines.append(f"const vec v{number} = {value};")
        lines += [f"{where} = v{number};" for where, number in results.items()]
        return "\n".join([*lines, "}"])

    def _needed(self, numbers: Collection[int], known: Collection[int]) -> list[int]:
        """Nodes that these take values from, in order; known ones need no others."""
        nodes = [
            node._replace(sources=()) if k in known else node
            for k, node in enumerate(self._nodes)
        ]
        return sorted(ancestors(nodes, numbers))
