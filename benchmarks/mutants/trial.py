"""Runs the tests of a room against a mutant, in a temporary copy of the tree."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.mutants.draw import Mutant
from benchmarks.mutants.mutations import applied

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


def verdict(tree: Path, mutant: Mutant, limit: float) -> str:
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
