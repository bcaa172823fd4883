"""The code reads plainly: names that say what they hold, short lines, functions, files."""

import ast
import collections
import functools
import io
import re
import statistics
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("oed", "models", "studies", "reports")
#: names that do not say what a value is
VAGUE = {"told", "made", "found", "left", "own", "beside", "kept", "seen"}
#: one of them as a word of its own, in code or not: other modules need no tree
WORD = re.compile(rf"\b_*({'|'.join(sorted(VAGUE))})_*\b")
#: tokens a line, 90th percentile; the closure equations of machines are formulas
MAX_TOKENS = {"oed": 20, "studies": 20, "reports": 20, "models": 22}
MAX_FUNCTION_LINES = 60
LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER,
}  # fmt: skip

Functions = ast.FunctionDef | ast.AsyncFunctionDef
Documented = ast.Module | ast.ClassDef | Functions


@functools.cache
def parsed(text: str) -> ast.Module:
    """Syntax tree of a module; the tests read it and change nothing."""
    return ast.parse(text)


@functools.cache
def sources(*folders: str) -> dict[str, str]:
    """Text of each module, by its path."""
    paths = [p for folder in folders for p in sorted((ROOT / folder).rglob("*.py"))]
    return {str(p.relative_to(ROOT)): p.read_text(encoding="utf-8") for p in paths}


def introduced(tree: ast.AST) -> Iterator[str]:
    """Names that a module gives to values, arguments, functions, classes, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, Functions | ast.ClassDef):
            yield node.name


def docstring(node: ast.AST) -> ast.stmt | None:
    if isinstance(node, Documented) and ast.get_docstring(node) is not None:
        return node.body[0]
    return None


def tokens_a_line(text: str) -> list[int]:
    """Tokens of each line of code; comments and docstrings aside."""
    documented: set[int] = set()
    for node in ast.walk(parsed(text)):
        statement = docstring(node)
        if statement is not None:
            last = statement.end_lineno or statement.lineno
            documented |= set(range(statement.lineno, last + 1))
    count: collections.Counter[int] = collections.Counter()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT and token.start[0] not in documented:
            count[token.start[0]] += 1
    return list(count.values())


def length(node: Functions) -> int:
    """Lines of a function without its docstring."""
    lines = (node.end_lineno or node.lineno) - node.lineno + 1
    statement = docstring(node)
    if statement is None:
        return lines
    return lines - ((statement.end_lineno or statement.lineno) - statement.lineno + 1)


def test_no_name_is_vague():
    vague = [
        f"{path}: {name}"
        for path, text in sources(*PACKAGES).items()
        if not path.startswith(str(Path("oed/gap"))) and WORD.search(text)
        for name in introduced(parsed(text))
        if name.strip("_") in VAGUE
    ]
    assert not vague


@pytest.mark.parametrize("code", [
    "told = 1", "def _made(): ...", "class C:\n    kept: int", "f = lambda own: 0",
])  # fmt: skip
def test_vague_names_are_recognised(code):
    assert any(name.strip("_") in VAGUE for name in introduced(parsed(code)))


@pytest.mark.parametrize("package", PACKAGES)
def test_lines_are_short(package):
    counts = [n for text in sources(package).values() for n in tokens_a_line(text)]
    assert statistics.quantiles(counts, n=10)[-1] <= MAX_TOKENS[package]


def test_tokens_are_counted():
    text = (
        '"""Two lines\nof text."""\n# a comment\nx = f(1, 2)  # seven and a bracket\n'
    )
    assert tokens_a_line(text) == [8]


def test_functions_are_short():
    assert not [
        f"{path}: {node.name} has {length(node)} lines"
        for path, text in sources(*PACKAGES, "tests", "benchmarks").items()
        for node in ast.walk(parsed(text))
        if isinstance(node, Functions) and length(node) > MAX_FUNCTION_LINES
    ]


def test_no_two_classes_share_a_name():
    where = collections.defaultdict(list)
    for path, text in sources(*PACKAGES).items():
        for node in ast.walk(parsed(text)):
            if isinstance(node, ast.ClassDef):
                where[node.name].append(path)
    assert not {name: paths for name, paths in where.items() if len(paths) > 1}


def test_the_diagnosis_has_few_rooms():
    entries = [p for p in (ROOT / "oed/gap").iterdir() if p.name != "__pycache__"]
    assert len(entries) <= 7


def test_reports_read_typed_results():
    texts = sources("reports")
    assert sum(text.count(".get(") for text in texts.values()) < 20
    assert not [path for path, text in texts.items() if "Mapping[str, Any]" in text]
