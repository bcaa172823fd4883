"""Mutate single expressions of the packages; name the mutants that their room's tests miss.

    python -m benchmarks.mutants --seed 1
    python -m benchmarks.mutants --seed 1 --count 20 --rooms oed/noise page

Draws lines over the rooms, and a mutation of each: a sign, a factor, an index, the
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
import copy
import dataclasses
import itertools
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

# -- mutations of a module, by its syntax tree -----------------------------------------
OPPOSITE = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt},
    **{ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
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
#: a node that lies in the text, and what stands in its place
Change = tuple[ast.expr | ast.stmt, ast.expr | ast.stmt]


@dataclasses.dataclass(frozen=True, slots=True)
class Mutation:
    """A piece of a module and what stands in its place.

    kind           name of its rule in RULES
    line           number of the line where the piece begins, from 1
    start, stop    bytes of the text that are replaced
    after          text in their place
    """

    kind: str
    line: int
    start: int
    stop: int
    after: str

    def applied(self, text: str) -> str:
        """The module's text with the mutation."""
        whole = text.encode()
        parts = (whole[: self.start], self.after.encode(), whole[self.stop :])
        return b"".join(parts).decode()

    def before(self, text: str) -> str:
        """The piece of the text that is replaced."""
        return text.encode()[self.start : self.stop].decode()


def mutations(text: str) -> list[Mutation]:
    """All mutations of a module."""
    tree = ast.parse(text)
    lengths = [len(line.encode()) for line in text.split("\n")]
    starts = [0, *itertools.accumulate(length + 1 for length in lengths)]
    subscripts = [n.slice for n in ast.walk(tree) if isinstance(n, ast.Subscript)]
    indices = {id(n) for index in subscripts for n in active_nodes(index)}
    found: dict[tuple[int, str], Mutation] = {}
    for node, (kind, rule) in itertools.product(active_nodes(tree), RULES.items()):
        for old, new in rule(node):
            is_index = kind == "factor" and id(old) in indices
            if is_index or ast.dump(old) == ast.dump(new):
                continue
            after = ast.unparse(new)
            after = f"({after})" if isinstance(new, ast.expr) else after
            start = starts[old.lineno - 1] + old.col_offset
            stop = starts[old.end_lineno - 1] + old.end_col_offset
            mutation = Mutation(kind, old.lineno, start, stop, after)
            found.setdefault((start, after), mutation)
    return list(found.values())


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


def _default(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.arguments):
        for value in (*node.defaults, *node.kw_defaults):
            if isinstance(value, ast.Constant) and isinstance(value.value, bool):
                yield value, ast.Constant(not value.value)
            elif value is not None:
                yield from _factor(value)


def _index(node: ast.AST) -> Iterator[Change]:
    """Off by one: constants of an index, bounds of a slice, the end of a range."""
    bounds: list[ast.expr | None] = []
    if isinstance(node, ast.Subscript):
        inner = (n for n in active_nodes(node.slice) if isinstance(n, ast.Constant))
        bounds = [n for n in inner if type(n.value) is int]
    elif isinstance(node, ast.Slice):
        bounds = [
            n for n in (node.lower, node.upper) if not isinstance(n, ast.Constant)
        ]
    elif isinstance(node, ast.Call) and _called(node) == "range":
        bounds = node.args[:2][-1:]
    for bound in bounds:
        if bound is not None:
            yield bound, ast.BinOp(bound, ast.Add(), ast.Constant(1))
            yield bound, ast.BinOp(bound, ast.Sub(), ast.Constant(1))


def _sign(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield node, node.operand
    if not isinstance(node, ast.AugAssign | ast.BinOp) or type(node.op) not in OPPOSITE:
        return
    if not any(map(_is_text, ast.iter_child_nodes(node))):
        yield node, _changed(node, op=OPPOSITE[type(node.op)]())


def _factor(node: ast.AST) -> Iterator[Change]:
    """Twice and half a number; 0 and 1 exchange; an odd integer is only doubled."""
    if not isinstance(node, ast.Constant) or type(node.value) not in (int, float):
        return
    number = node.value
    if number in (0, 1):
        yield node, ast.Constant(type(number)(1 - number))
        return
    yield node, ast.Constant(2 * number)
    if isinstance(number, float) or number % 2 == 0:
        yield node, ast.Constant(type(number)(number / 2))


def _swap(node: ast.AST) -> Iterator[Change]:
    if not isinstance(node, ast.Call) or _called(node) in SYMMETRIC:
        return
    for k, pair in enumerate(itertools.pairwise(node.args)):
        if not any(isinstance(argument, ast.Starred) for argument in pair):
            swapped = [*node.args[:k], *pair[::-1], *node.args[k + 2 :]]
            yield node, _changed(node, args=swapped)


def _comparison(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.Compare):
        for k, operator in enumerate(node.ops):
            if type(operator) in OPPOSITE:
                turned = [*node.ops[:k], OPPOSITE[type(operator)](), *node.ops[k + 1 :]]
                yield node, _changed(node, ops=turned)


def _extremum(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.Call) and _called(node) in EXCHANGED:
        name = EXCHANGED[_called(node)]
        field = "id" if isinstance(node.func, ast.Name) else "attr"
        yield node.func, _changed(node.func, **{field: name})


def _negation(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node, node.operand


#: the first rule that gives a mutated text names its kind
RULES: dict[str, Callable[[ast.AST], Iterator[Change]]] = {
    "default": _default,
    "index": _index,
    "sign": _sign,
    "factor": _factor,
    "swap": _swap,
    "comparison": _comparison,
    "extremum": _extremum,
    "negation": _negation,
}


def _changed(node: Any, **fields: Any) -> Any:
    """A node with other fields."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def _called(node: ast.Call) -> str:
    """Last name of the function that a node calls; empty where it has none."""
    return getattr(node.func, "id", getattr(node.func, "attr", ""))


def _is_text(node: ast.AST) -> bool:
    is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return is_text or isinstance(node, ast.JoinedStr)


# -- mutants over the rooms ------------------------------------------------------------
TESTS = Path("tests")
#: folders of the packages; their folders of tests have no prefix
PACKAGES = ("oed", "models/pkm_*", "reports/pkm_*", "studies/pkm_*")
SPARE = 4  #: so many candidates are drawn for each mutant: some lines are not reached


@dataclasses.dataclass(frozen=True, slots=True)
class Mutant:
    """A mutation of a module of a room."""

    room: str  #: folder of its tests, from `tests`
    path: str  #: of the module, from the root of the tree
    mutation: Mutation  #: the change


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
    """How many of `count` drawn lines lie in each room, and candidates in their order.

    Candidates lie on different lines; the kind is drawn before the mutation. A room has
    fewer where it has fewer lines to mutate.
    """
    lines: list[tuple[str, str, list[Mutation]]] = []
    modules = rooms_of(root)
    for room in rooms:
        for path in modules[room]:
            by_line: dict[int, list[Mutation]] = {}
            for mutation in mutations(path.read_text("utf-8")):
                by_line.setdefault(mutation.line, []).append(mutation)
            name = path.relative_to(root).as_posix()
            lines += [(room, name, by_line[line]) for line in sorted(by_line)]
    order = [lines[k] for k in rng.permutation(len(lines))]
    drawn = []
    for room, share in sorted(Counter(room for room, *_ in order[:count]).items()):
        of_room = [line for line in order if line[0] == room][: SPARE * share]
        mutants = [Mutant(room, name, _pick(some, rng)) for _, name, some in of_room]
        drawn.append((share, mutants))
    return drawn


def _pick(choices: list[Mutation], rng: np.random.Generator) -> Mutation:
    """A mutation of a line, its kind first."""
    kinds = sorted({choice.kind for choice in choices})
    kind = kinds[rng.integers(len(kinds))]
    of_kind = [choice for choice in choices if choice.kind == kind]
    return of_kind[rng.integers(len(of_kind))]


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
    text = mutant.mutation.applied((tree / mutant.path).read_text("utf-8"))
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
        _print_trial(tree, mutant, verdict)
        yield mutant, verdict


def _print_trial(tree: Path, mutant: Mutant, verdict: str) -> None:
    mutation = mutant.mutation
    line = f"{mutant.path}:{mutation.line}"
    print(f"{verdict:11s}  {mutation.kind:10s}  {line}", flush=True)
    if verdict not in DETECTED:
        text = (tree / mutant.path).read_text("utf-8")
        print(f"    - {mutation.before(text)}", flush=True)
        print(f"    + {mutation.after}", flush=True)


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
