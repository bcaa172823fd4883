"""Mutate single lines of the packages; name the mutants that their room's tests miss.

    python -m benchmarks.mutants --seed 1
    python -m benchmarks.mutants --seed 1 --count 20 --rooms oed/noise page

Draws mutations over the rooms by their lines of code: a sign, a factor, an index, the
order of two arguments, a comparison, an extremum, a negation or a default changes;
docstrings, annotations, decorators and formatted strings stay. A room is a folder of
tests with the modules that it mirrors: tests/oed/gap has those of oed/gap, tests/page
those of studies/pkm_page. Its tests run in a temporary copy of the tree: unmutated, which
tells what reaches the drawn statements, then against each mutant, those that reach it
first. A mutant is killed by a failure or by the time limit; those that survive are
printed. A statement that no test of the room reaches is printed, does not count, and
another one of the room stands in its place.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import contextlib
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
from typing import NamedTuple

import numpy as np

# -- mutations of a module, by its syntax tree -----------------------------------------


SIGNS = {ast.Add: "+-", ast.Sub: "-+", ast.Mult: "*/", ast.Div: "/*"}
TURNED = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
EXTREMA = (("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"))
EXCHANGED = dict(EXTREMA) | {most: least for least, most in EXTREMA}
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


class Edit(NamedTuple):
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
            operands = (node.left, node.right)
            yield from source.replace_operator(*operands, *SIGNS[type(node.op)])
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
    sides = itertools.pairwise([node.left, *node.comparators])
    for operator, (left, right) in zip(node.ops, sides, strict=True):
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


TESTS = Path("tests")
#: folders of the packages; their folders of tests have no prefix
PACKAGES = ("oed", "models/pkm_*", "reports/pkm_*", "studies/pkm_*")
#: so many candidates are drawn for each mutant: some lines are not reached
SPARE = 4


@dataclasses.dataclass(frozen=True, slots=True)
class Mutant:
    """A mutation of a module of a room.

    room        folder of its tests, from `tests`
    path        of the module, from the root of the tree
    mutation    the changed line
    """

    room: str
    path: str
    mutation: Mutation


def rooms_of(root: Path) -> dict[str, list[Path]]:
    """Modules by room; what no folder of tests mirrors belongs to its package's."""
    rooms: dict[str, list[Path]] = {}
    for package in itertools.chain.from_iterable(map(root.glob, PACKAGES)):
        house = package.name.removeprefix("pkm_")
        for path in sorted(package.rglob("*.py")):
            first = path.relative_to(package).parts[0].removesuffix(".py")
            mirrored = (root / TESTS / house / first).is_dir()
            room = f"{house}/{first}" if mirrored else house
            rooms.setdefault(room, []).append(path)
    return dict(sorted(rooms.items()))


def draw(
    root: Path, rooms: list[str], count: int, rng: np.random.Generator
) -> list[tuple[int, list[Mutant]]]:
    """Shares of `count` of the rooms that have one, and candidates in their order.

    Candidates lie on different lines; the kind is drawn before the mutation. A room has
    fewer where it has fewer lines to mutate.
    """
    modules = rooms_of(root)
    texts = [
        {path: path.read_text("utf-8") for path in modules[room]} for room in rooms
    ]
    numbers = [sum(len(code_lines(t)) for t in room.values()) for room in texts]
    drawn = []
    for room, of_room, share in zip(rooms, texts, shares(numbers, count), strict=True):
        found = itertools.islice(_draw_in_room(of_room, rng), SPARE * share)
        names = [(path.relative_to(root).as_posix(), change) for path, change in found]
        drawn.append((share, [Mutant(room, *named) for named in names]))
    return [of_room for of_room in drawn if of_room[1]]


def shares(sizes: list[int], count: int) -> list[int]:
    """`count` in whole parts proportional to the sizes, by largest remainders."""
    exact = count * np.array(sizes) / sum(sizes)
    whole = np.floor(exact).astype(int)
    order = np.argsort(whole - exact, kind="stable")
    whole[order[: count - whole.sum()]] += 1
    return whole.tolist()


def _draw_in_room(
    texts: dict[Path, str], rng: np.random.Generator
) -> Iterator[tuple[Path, Mutation]]:
    by_line: dict[tuple[Path, int], list[Mutation]] = {}
    for path, text in texts.items():
        for mutation in mutations(text):
            by_line.setdefault((path, mutation.line), []).append(mutation)
    lines = sorted(by_line)
    for k in rng.permutation(len(lines)):
        path, _ = lines[k]
        choices = by_line[lines[k]]
        kinds = sorted({choice.kind for choice in choices})
        kind = kinds[rng.integers(len(kinds))]
        of_kind = [choice for choice in choices if choice.kind == kind]
        mutation = of_kind[rng.integers(len(of_kind))]
        if is_valid(texts[path], mutation):
            yield path, mutation


# -- the tests that reach a statement --------------------------------------------------


#: module of the copy: writes each test that executes a marked statement, once
MARKS = '''"""Marks of statements."""
import os
FOLDER, SEEN = os.path.dirname(os.path.abspath(__file__)), set()
def mark(number):
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    if (number, test) not in SEEN:
        SEEN.add((number, test))
        with open(os.path.join(FOLDER, "reached.txt"), "a", encoding="utf-8") as file:
            file.write(f"{number} {test}" + chr(10))
'''


def marked(text: str, numbers: dict[int, int]) -> str:
    """The module with a call of `mark(number)` before the innermost statement of a line."""
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    statements: dict[int, ast.AST] = {}
    for node in nodes:
        if isinstance(node, ast.stmt):
            lines = range(node.lineno, (node.end_lineno or node.lineno) + 1)
            statements |= dict.fromkeys(lines, node)
    marks: dict[ast.AST, list[ast.stmt]] = {}
    for line, number in numbers.items():
        call = f"__import__('reached_lines').mark({number})"
        marks.setdefault(statements[line], []).extend(ast.parse(call).body)
    for node in nodes:
        for _, children in ast.iter_fields(node):
            if isinstance(children, list):
                parts = ((*marks.get(child, ()), child) for child in children)
                children[:] = itertools.chain.from_iterable(parts)
    return ast.unparse(tree)


# -- trials ----------------------------------------------------------------------------


#: where the packages of a tree lie; before the installed ones
SEARCHED = (".", "models", "studies", "reports", "tests", "tests/fixtures")
IGNORED = shutil.ignore_patterns(".*", "__pycache__", "out")
#: seconds that a mutant may take: so many times the unchanged tests, and a margin
SLOWER, MARGIN = 4.0, 20.0
#: pytest's exit codes where tests fail, and where they cannot be collected
FAILURES = {1, 2}

KILLED, TIMED_OUT, SURVIVED = "killed", "time limit", "survived"
NOT_REACHED, NOT_JUDGED = "not reached", "not judged"


@contextlib.contextmanager
def copied(root: Path) -> Iterator[Path]:
    """A temporary copy of a tree; data beside it stand beside the copy as well."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(root, tree, ignore=IGNORED)
        data = root.parent / "shared"
        if data.is_dir():
            (tree.parent / "shared").symlink_to(data.resolve())
        compileall.compile_dir(tree, quiet=2)
        yield tree


@contextlib.contextmanager
def replaced(tree: Path, texts: dict[str, str]) -> Iterator[None]:
    """Files of the copy have other texts; they are as before afterwards."""
    before = {name: (tree / name).read_text("utf-8") for name in texts}
    try:
        for name, text in texts.items():
            (tree / name).write_text(text, "utf-8")
        yield
    finally:
        for name, text in before.items():
            (tree / name).write_text(text, "utf-8")


def baseline(
    tree: Path, candidates: list[Mutant]
) -> tuple[bool, float, dict[int, list[str]]]:
    """Run the room's tests unmutated.

    Returns whether there are tests and all pass, the seconds that a mutant may take, and
    the tests that execute the statement of the k-th candidate, by k.
    """
    numbers: dict[str, dict[int, int]] = {}
    for k, mutant in enumerate(candidates):
        numbers.setdefault(mutant.path, {})[mutant.mutation.line] = k
    texts = {p: marked((tree / p).read_text("utf-8"), n) for p, n in numbers.items()}
    (tree / "reached_lines.py").write_text(MARKS, "utf-8")
    (tree / "reached.txt").write_text("", "utf-8")
    start = time.monotonic()
    with replaced(tree, texts):
        code = _run_tests(tree, str(TESTS / candidates[0].room), None)
    limit = MARGIN + SLOWER * (time.monotonic() - start)
    reaching: dict[int, list[str]] = {}
    for line in (tree / "reached.txt").read_text("utf-8").splitlines():
        number, _, test = line.partition(" ")
        reaching.setdefault(int(number), []).extend([test] if test else [])
    return code == 0, limit, reaching


def try_mutant(tree: Path, mutant: Mutant, first: list[str], limit: float) -> str:
    """KILLED, TIMED_OUT or SURVIVED; the tests that reach the statement run first."""
    text = applied((tree / mutant.path).read_text("utf-8"), mutant.mutation)
    (tree / "reaching.txt").write_text("\n".join(first), "utf-8")
    try:
        with replaced(tree, {mutant.path: text}):
            if first and _run_tests(tree, "@reaching.txt", limit) in FAILURES:
                return KILLED
            code = _run_tests(tree, str(TESTS / mutant.room), limit)
    except subprocess.TimeoutExpired:
        return TIMED_OUT
    return KILLED if code else SURVIVED


def _run_tests(tree: Path, tests: str, limit: float | None) -> int:
    """pytest's exit code; subprocess.TimeoutExpired after `limit` seconds.

    The copy's modules are imported, and no bytecode of a mutant remains.
    """
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    search = os.pathsep.join(str(tree / name) for name in SEARCHED)
    settings = {"PYTHONPATH": search, "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", tests, *options],
        cwd=tree,
        env={"OPENBLAS_NUM_THREADS": "1", **os.environ, **settings},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        return process.wait(limit)
    finally:
        process.kill()
        process.wait()


# -- command ---------------------------------------------------------------------------


ROOT = Path(__file__).resolve().parents[1]
DETECTED = {KILLED, TIMED_OUT}

Trial = tuple[Mutant, str]


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Exit code: 0 all mutants are killed, 1 some survive, 2 bad input."""
    rooms = list(rooms_of(root))
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=60, help="of mutants judged")
    parser.add_argument("--rooms", nargs="+", choices=rooms, metavar="ROOM")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    drawn = draw(root, options.rooms or rooms, options.count, rng)
    with copied(root) as tree:
        trials = [trial for of_room in drawn for trial in _trials(tree, *of_room)]
    _print_summary(trials)
    return int(any(verdict in (SURVIVED, NOT_JUDGED) for _, verdict in trials))


def _trials(tree: Path, share: int, candidates: list[Mutant]) -> Iterator[Trial]:
    """Candidates with their verdicts, until the room's share is judged."""
    passes, limit, reaching = baseline(tree, candidates)
    judged = 0
    for k, mutant in enumerate(candidates):
        if judged == share:
            return
        verdict = NOT_REACHED if passes else NOT_JUDGED
        if passes and k in reaching:
            verdict = try_mutant(tree, mutant, reaching[k], limit)
        judged += verdict != NOT_REACHED
        _print_trial(mutant, verdict)
        yield mutant, verdict


def _print_trial(mutant: Mutant, verdict: str) -> None:
    mutation = mutant.mutation
    line = f"{mutant.path}:{mutation.line}"
    print(f"{verdict:11s}  {mutation.kind:10s}  {line}", flush=True)
    if verdict not in DETECTED:
        print(f"    - {mutation.before.strip()}", flush=True)
        print(f"    + {mutation.after.strip()}", flush=True)


def _print_summary(trials: list[Trial]) -> None:
    shown = (SURVIVED, NOT_REACHED, NOT_JUDGED)
    print(f"\n{'room':20s}{'judged':>12s}" + "".join(f"{v:>13s}" for v in shown))
    by_room = {mutant.room: Counter() for mutant, _ in trials}
    for mutant, verdict in trials:
        by_room[mutant.room][verdict] += 1
    by_room["all"] = sum(by_room.values(), Counter())
    for room, numbers in by_room.items():
        judged = sum(numbers[v] for v in (*DETECTED, SURVIVED))
        print(f"{room:20s}{judged:12d}" + "".join(f"{numbers[v]:13d}" for v in shown))


if __name__ == "__main__":
    sys.exit(main())
