"""Single-line mutations of a module's text, by its syntax tree.

Docstrings, annotations, decorators and formatted strings stay as they are.
"""

from __future__ import annotations

import ast
import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator

SIGNS = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
}
TURNED = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
EXCHANGED = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "argmin": "argmax",
    "argmax": "argmin",
}
#: functions whose first arguments may change places
SYMMETRIC = {
    *("min", "max", "minimum", "maximum", "hypot", "logaddexp"),
    *("isclose", "allclose", "array_equal", "union1d", "intersect1d"),
}
#: fields of a node that compute nothing
PASSIVE = {"annotation", "returns", "decorator_list"}


@dataclasses.dataclass(frozen=True, slots=True)
class Mutation:
    """A line of a module and what stands in its place.

    kind      name of its rule in RULES
    line      number of the line, from 1
    before    text of the line
    after     mutated text
    """

    kind: str
    line: int
    before: str
    after: str


@dataclasses.dataclass(frozen=True, slots=True)
class Edit:
    """Text in place of the characters from start to stop of a line (from 1)."""

    line: int
    start: int
    stop: int
    text: str


class Source:
    """The lines of a module; columns count characters, not bytes."""

    def __init__(self, text: str) -> None:
        self.lines = text.split("\n")

    def start(self, node: ast.expr) -> int:
        return self._column(node.lineno, node.col_offset)

    def stop(self, node: ast.expr) -> int:
        return self._column(node.end_lineno or node.lineno, node.end_col_offset or 0)

    def text(self, node: ast.expr) -> str:
        return self.lines[node.lineno - 1][self.start(node) : self.stop(node)]

    def replaced(self, edit: Edit) -> str:
        line = self.lines[edit.line - 1]
        return line[: edit.start] + edit.text + line[edit.stop :]

    def replace(self, node: ast.expr, text: str) -> Iterator[Edit]:
        if _on_one_line(node):
            yield Edit(node.lineno, self.start(node), self.stop(node), text)

    def replace_operator(
        self, left: ast.expr, right: ast.expr, old: str, new: str
    ) -> Iterator[Edit]:
        """Exchange the operator between two operands, where they share its line."""
        if left.end_lineno != right.lineno:
            return
        stop = self.stop(left)
        between = self.lines[right.lineno - 1][stop : self.start(right)]
        if between.strip("() ") == old:
            place = stop + between.index(old)
            yield Edit(right.lineno, place, place + len(old), new)

    def _column(self, line: int, offset: int) -> int:
        return len(self.lines[line - 1].encode()[:offset].decode())


def mutations(text: str) -> list[Mutation]:
    """All mutations of a module; some may not compile (`is_valid`)."""
    source = Source(text)
    tree = ast.parse(text)
    indices = _constants_of_indices(tree)
    distinct: dict[tuple[int, str], Mutation] = {}
    for node, (kind, rule) in itertools.product(active_nodes(tree), RULES.items()):
        if kind == "factor" and id(node) in indices:
            continue
        for edit in rule(node, source):
            before = source.lines[edit.line - 1]
            mutation = Mutation(kind, edit.line, before, source.replaced(edit))
            distinct.setdefault((edit.line, mutation.after), mutation)
    return list(distinct.values())


def is_valid(text: str, mutation: Mutation) -> bool:
    """Whether the mutated module compiles and its syntax tree is another one."""
    try:
        tree = ast.parse(applied(text, mutation))
        compile(tree, "mutant", "exec")
    except (SyntaxError, ValueError):
        return False
    return ast.dump(tree) != ast.dump(ast.parse(text))


def applied(text: str, mutation: Mutation) -> str:
    """The module's text with the mutated line."""
    lines = text.split("\n")
    lines[mutation.line - 1] = mutation.after
    return "\n".join(lines)


def active_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes that compute: none of annotations, decorators and formatted strings."""
    yield node
    for name, value in ast.iter_fields(node):
        if name in PASSIVE:
            continue
        children = value if isinstance(value, list) else [value]
        for child in children:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield from active_nodes(child)


def code_lines(text: str) -> set[int]:
    """Lines on which a node begins that computes; docstrings aside."""
    nodes = active_nodes(ast.parse(text))
    return {n.lineno for n in nodes if isinstance(n, ast.expr) and not _is_text(n)}


def _constants_of_indices(tree: ast.AST) -> set[int]:
    subscripts = (n for n in active_nodes(tree) if isinstance(n, ast.Subscript))
    inner = itertools.chain.from_iterable(active_nodes(s.slice) for s in subscripts)
    return {id(node) for node in inner if isinstance(node, ast.Constant)}


def _sign(node: ast.AST, source: Source) -> Iterator[Edit]:
    if isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
        if not (_is_text(node.left) or _is_text(node.right)):
            signs = SIGNS[type(node.op)]
            yield from source.replace_operator(node.left, node.right, *signs)
    elif isinstance(node, ast.AugAssign) and type(node.op) in SIGNS:
        old, new = SIGNS[type(node.op)]
        pair = (f"{old}=", f"{new}=")
        yield from source.replace_operator(node.target, node.value, *pair)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        start = source.start(node)
        yield Edit(node.lineno, start, start + 1, "")


def _factor(node: ast.AST, source: Source) -> Iterator[Edit]:
    if isinstance(node, ast.Constant):
        for value in _other_factors(node.value):
            yield from source.replace(node, repr(value))


def _index(node: ast.AST, source: Source) -> Iterator[Edit]:
    """Off by one: constants of an index, bounds of a slice, the end of a range."""
    if isinstance(node, ast.Subscript):
        for inner in active_nodes(node.slice):
            if isinstance(inner, ast.Constant) and type(inner.value) is int:
                yield from source.replace(inner, str(inner.value + 1))
                yield from source.replace(inner, str(inner.value - 1))
    elif isinstance(node, ast.Slice):
        for bound in (node.lower, node.upper):
            yield from _shifted(bound, source)
    elif _called(node) == "range":
        arguments = node.args  # type: ignore[attr-defined]
        yield from _shifted(arguments[min(1, len(arguments) - 1)], source)


def _shifted(bound: ast.expr | None, source: Source) -> Iterator[Edit]:
    if bound is None or isinstance(bound, ast.Constant) or not _on_one_line(bound):
        return
    text = source.text(bound)
    yield from source.replace(bound, f"({text}) + 1")
    yield from source.replace(bound, f"({text}) - 1")


def _swap(node: ast.AST, source: Source) -> Iterator[Edit]:
    if not isinstance(node, ast.Call) or _called(node) in SYMMETRIC:
        return
    for first, second in itertools.pairwise(node.args):
        if isinstance(first, ast.Starred) or isinstance(second, ast.Starred):
            continue
        if first.lineno != second.end_lineno:
            continue
        line = source.lines[first.lineno - 1]
        between = line[source.stop(first) : source.start(second)]
        text = source.text(second) + between + source.text(first)
        yield Edit(first.lineno, source.start(first), source.stop(second), text)


def _comparison(node: ast.AST, source: Source) -> Iterator[Edit]:
    if not isinstance(node, ast.Compare):
        return
    operands = [node.left, *node.comparators]
    for operator, (left, right) in zip(
        node.ops, itertools.pairwise(operands), strict=True
    ):
        if type(operator) in TURNED:
            pair = TURNED[type(operator)]
            yield from source.replace_operator(left, right, *pair)


def _extremum(node: ast.AST, source: Source) -> Iterator[Edit]:
    name = _called(node)
    if name in EXCHANGED:
        function = node.func  # type: ignore[attr-defined]
        text = re.sub(rf"{name}$", EXCHANGED[name], source.text(function))
        yield from source.replace(function, text)


def _negation(node: ast.AST, source: Source) -> Iterator[Edit]:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        start = source.start(node)
        yield Edit(node.lineno, start, start + len("not"), "")


def _default(node: ast.AST, source: Source) -> Iterator[Edit]:
    if not isinstance(node, ast.arguments):
        return
    for value in (*node.defaults, *node.kw_defaults):
        if not isinstance(value, ast.Constant):
            continue
        if isinstance(value.value, bool):
            yield from source.replace(value, repr(not value.value))
        for other in _other_factors(value.value):
            yield from source.replace(value, repr(other))


#: the first rule that gives a mutated line names its kind
RULES: dict[str, Callable[[ast.AST, Source], Iterator[Edit]]] = {
    "default": _default,
    "index": _index,
    "sign": _sign,
    "factor": _factor,
    "swap": _swap,
    "comparison": _comparison,
    "extremum": _extremum,
    "negation": _negation,
}


def _other_factors(value: object) -> list[float]:
    """Twice and half a number; 0 and 1 exchange; an odd integer is only doubled."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return []
    if value in (0, 1):
        return [type(value)(1 - value)]
    if isinstance(value, float):
        return [2.0 * value, value / 2.0]
    return [2 * value] if value % 2 else [2 * value, value // 2]


def _called(node: ast.AST) -> str:
    """Last name of the function that a node calls; empty where it calls none."""
    if not isinstance(node, ast.Call) or not _on_one_line(node.func):
        return ""
    if isinstance(node.func, ast.Name):
        return node.func.id
    return node.func.attr if isinstance(node.func, ast.Attribute) else ""


def _is_text(node: ast.expr) -> bool:
    if isinstance(node, ast.JoinedStr):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _on_one_line(node: ast.expr) -> bool:
    return node.lineno == node.end_lineno
