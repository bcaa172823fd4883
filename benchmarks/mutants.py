"""Mutate single lines of `oed`, and name the mutants that their room's tests miss.

    python -m benchmarks.mutants --seed 1
    python -m benchmarks.mutants --seed 1 --count 20 --rooms noise gap --out mutants.csv

Draws mutations over the rooms by their lines of code: a sign, a factor, an index, the
order of two arguments, a comparison, an extremum, a negation or a default changes;
docstrings, annotations, decorators and formatted strings stay. The tests in
tests/oed/<room> run against each, in a temporary copy of the tree. A mutant is killed by
a failure or by the time limit; those that survive are printed.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import csv
import dataclasses
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

# -- mutations of a module, by its syntax tree -----------------------------------------


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


# -- mutants over the rooms ------------------------------------------------------------


PACKAGE = "oed"


@dataclasses.dataclass(frozen=True, slots=True)
class Mutant:
    """A mutation of a module of a room.

    room        folder of `oed`
    path        of the module, from the root of the tree
    mutation    the changed line
    """

    room: str
    path: str
    mutation: Mutation


def rooms_of(root: Path) -> list[str]:
    """The rooms of `oed`: its folders that hold modules, sorted."""
    folders = sorted((root / PACKAGE).iterdir())
    return [folder.name for folder in folders if any(folder.glob("*.py"))]


def draw(
    root: Path, rooms: list[str], count: int, rng: np.random.Generator
) -> list[Mutant]:
    """`count` mutants: at most one a line, the kind drawn before the mutation.

    A room gives fewer than its share where it has fewer lines to mutate.
    """
    numbers = [_number_of_lines(root, room) for room in rooms]
    mutants = []
    for room, number in zip(rooms, shares(numbers, count), strict=True):
        mutants += _draw_in_room(root, room, number, rng)
    return mutants


def shares(sizes: list[int], count: int) -> list[int]:
    """`count` in whole parts proportional to the sizes, by largest remainders."""
    exact = count * np.array(sizes) / sum(sizes)
    whole = np.floor(exact).astype(int)
    order = np.argsort(whole - exact, kind="stable")
    whole[order[: count - whole.sum()]] += 1
    return whole.tolist()


def _draw_in_room(
    root: Path, room: str, count: int, rng: np.random.Generator
) -> list[Mutant]:
    texts = {
        path.relative_to(root).as_posix(): path.read_text(encoding="utf-8")
        for path in _modules(root, room)
    }
    by_line: dict[tuple[str, int], list[Mutation]] = {}
    for name, text in texts.items():
        for mutation in mutations(text):
            by_line.setdefault((name, mutation.line), []).append(mutation)
    lines = sorted(by_line)
    mutants: list[Mutant] = []
    for k in rng.permutation(len(lines)):
        if len(mutants) == count:
            break
        name, _ = lines[k]
        mutation = _draw_mutation(by_line[lines[k]], rng)
        if is_valid(texts[name], mutation):
            mutants.append(Mutant(room, name, mutation))
    return mutants


def _draw_mutation(choices: list[Mutation], rng: np.random.Generator) -> Mutation:
    kinds = sorted({choice.kind for choice in choices})
    kind = kinds[rng.integers(len(kinds))]
    of_kind = [choice for choice in choices if choice.kind == kind]
    return of_kind[rng.integers(len(of_kind))]


def _number_of_lines(root: Path, room: str) -> int:
    texts = (path.read_text(encoding="utf-8") for path in _modules(root, room))
    return sum(len(code_lines(text)) for text in texts)


def _modules(root: Path, room: str) -> list[Path]:
    return sorted((root / PACKAGE / room).rglob("*.py"))


# -- trials ----------------------------------------------------------------------------


TESTS = Path("tests") / "oed"
#: where the packages of a tree lie; before the installed ones
PACKAGES = (".", "models", "studies", "reports", "tests", "tests/fixtures")
IGNORED = shutil.ignore_patterns(".*", "__pycache__", "out")
#: seconds that a mutant may take: so many times the unchanged tests, and a margin
SLOWER, MARGIN = 4.0, 20.0

KILLED, TIMED_OUT, SURVIVED = "killed", "time limit", "survived"
NO_TESTS = "no tests"


class FailingTestsError(Exception):
    """The tests of a room fail without any mutation."""


@contextlib.contextmanager
def copied(root: Path) -> Iterator[Path]:
    """A temporary copy of a tree; data beside it stand beside the copy as well."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(root, tree, ignore=IGNORED)
        data = root.parent / "shared"
        if data.is_dir():
            (tree.parent / "shared").symlink_to(data.resolve())
        yield tree


def limit_of(tree: Path, room: str) -> float:
    """Seconds that the tests of a room may take, from a run without mutation."""
    start = time.monotonic()
    if _run_tests(tree, room, None) != SURVIVED:
        command = f"pytest {TESTS / room}"
        raise FailingTestsError(f"{command} fails without a mutation: mend that first.")
    return MARGIN + SLOWER * (time.monotonic() - start)


def has_tests(tree: Path, room: str) -> bool:
    return any((tree / TESTS / room).glob("test_*.py"))


def try_mutant(tree: Path, mutant: Mutant, limit: float) -> str:
    """KILLED, TIMED_OUT or SURVIVED; the copy is as before afterwards."""
    path = tree / mutant.path
    text = path.read_text(encoding="utf-8")
    path.write_text(applied(text, mutant.mutation), encoding="utf-8")
    try:
        return _run_tests(tree, mutant.room, limit)
    finally:
        path.write_text(text, encoding="utf-8")


def _run_tests(tree: Path, room: str, limit: float | None) -> str:
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    command = [sys.executable, "-m", "pytest", str(TESTS / room), *options]
    process = subprocess.Popen(
        command,
        cwd=tree,
        env=_environment(tree),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        return KILLED if process.wait(limit) else SURVIVED
    except subprocess.TimeoutExpired:
        return TIMED_OUT
    finally:
        process.kill()
        process.wait()


def _environment(tree: Path) -> dict[str, str]:
    """The copy's modules are imported; no bytecode of a mutant remains."""
    search = os.pathsep.join(str(tree / name) for name in PACKAGES)
    settings = {"PYTHONPATH": search, "PYTHONDONTWRITEBYTECODE": "1"}
    return {"OPENBLAS_NUM_THREADS": "1", **os.environ, **settings}


# -- command ---------------------------------------------------------------------------


ROOT = Path(__file__).resolve().parents[1]
DETECTED = {KILLED, TIMED_OUT}
COLUMNS = ("room", "file", "line", "kind", "verdict", "before", "after")

Trial = tuple[Mutant, str]


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Exit code: 0 all mutants are killed, 1 some survive, 2 bad input."""
    rooms = rooms_of(root)
    parser = _parser(rooms)
    options = parser.parse_args(arguments)
    if options.out and options.out.exists():
        parser.error(f"--out {options.out} exists: name a new file or remove it.")
    rng = np.random.default_rng(options.seed)
    mutants = draw(root, options.rooms or rooms, options.count, rng)
    try:
        trials = list(_trials(root, mutants))
    except FailingTestsError as error:
        parser.error(str(error))
    if options.out:
        _write(options.out, trials)
    _print_summary(trials)
    return int(any(verdict not in DETECTED for _, verdict in trials))


def _trials(root: Path, mutants: list[Mutant]) -> Iterator[Trial]:
    limits: dict[str, float] = {}
    with copied(root) as tree:
        for mutant in mutants:
            verdict = NO_TESTS
            if has_tests(tree, mutant.room):
                if mutant.room not in limits:
                    limits[mutant.room] = limit_of(tree, mutant.room)
                verdict = try_mutant(tree, mutant, limits[mutant.room])
            _print_trial(mutant, verdict)
            yield mutant, verdict


def _print_trial(mutant: Mutant, verdict: str) -> None:
    mutation = mutant.mutation
    place = f"{mutant.path}:{mutation.line}"
    print(f"{verdict:10s}  {mutation.kind:10s}  {place}", flush=True)
    if verdict not in DETECTED:
        print(f"    - {mutation.before.strip()}", flush=True)
        print(f"    + {mutation.after.strip()}", flush=True)


def _print_summary(trials: list[Trial]) -> None:
    drawn = Counter(mutant.room for mutant, _ in trials)
    killed = Counter(mutant.room for mutant, v in trials if v in DETECTED)
    print(f"\n{'room':20s}{'mutants':>8s}{'survivors':>11s}")
    for room, number in sorted(drawn.items()):
        print(f"{room:20s}{number:8d}{number - killed[room]:11d}")
    print(f"{'all':20s}{drawn.total():8d}{drawn.total() - killed.total():11d}")


def _write(path: Path, trials: list[Trial]) -> None:
    with path.open("x", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for mutant, verdict in trials:
            m = mutant.mutation
            texts = (m.before.strip(), m.after.strip())
            row = (mutant.room, mutant.path, m.line, m.kind, verdict, *texts)
            writer.writerow(row)


def _parser(rooms: list[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.mutants",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=60, help="of mutants")
    parser.add_argument("--rooms", nargs="+", choices=rooms, metavar="ROOM")
    parser.add_argument("--out", type=Path, help="a table of all mutants (CSV)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
