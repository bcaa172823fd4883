"""Compiled files: two processes at once, damaged files, no compiler, no folder."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from kernel.mechanism.compiling import compiled, needs_compiler
from oed.mechanism import BatchedFunction
from oed.mechanism import compiled as compiler

pytestmark = needs_compiler
X = ca.SX.sym("x", 2)
POINTS = np.array([[1.0, 2.0], [3.0, 4.0]])
PROGRAM = """
import sys, time
from pathlib import Path
from oed.mechanism import compiled as compiler
folder, text, start = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
compiler.cache_folder = lambda: folder
time.sleep(max(0.0, start - time.time()))
library = compiler.compiled_text(text)
library.make()
print(library.functions.answer())
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of compiled files; every call looks into it anew."""
    monkeypatch.setattr(compiler, "cache_folder", lambda: tmp_path / "compiled")
    forget()
    yield tmp_path / "compiled"
    forget()


def forget() -> None:
    """As in a new process."""
    compiler._compiled_text.cache_clear()
    compiler.find_compiler.cache_clear()


def text_of(number: int) -> str:
    return f"int answer(void) {{ return {number}; }}"


def runs_compiled() -> bool:
    """Whether a function is compiled now; its values hold in any case."""
    function = compiled(lambda: BatchedFunction("f", [X], [2.0 * X]))
    np.testing.assert_array_equal(function(POINTS)[0], 2.0 * POINTS)
    return function._jobs[compiler.Evaluation].ready is not None


def load(text: str) -> Any:
    """The functions of a text, compiled or found."""
    library = compiler.compiled_text(text)
    library.make()
    return library.functions


def test_a_text_is_compiled_once(folder, monkeypatch):
    assert load(text_of(41)).answer() == 41
    (file,) = folder.iterdir()
    forget()
    monkeypatch.setattr(compiler, "_compile", None)
    assert load(text_of(41)).answer() == 41
    assert [*folder.iterdir()] == [file]
    assert folder.stat().st_mode & 0o777 == 0o700


def test_another_compiler_or_processor_compiles_anew(folder, monkeypatch):
    load(text_of(42))
    for identity in ("another", "a third"):
        known = compiler.find_compiler(os.environ["PATH"])
        changed = compiler.Compiler(known.path, identity)
        monkeypatch.setattr(compiler, "find_compiler", lambda _, c=changed: c)
        assert load(text_of(42)).answer() == 42
        monkeypatch.undo()
        monkeypatch.setattr(compiler, "cache_folder", lambda: folder)
    assert len([*folder.iterdir()]) == 3


def test_machines_of_other_dimensions_share_a_file(folder):
    for number in (0.5, 0.7):
        function = compiled(lambda n=number: BatchedFunction("f", [X], [n * X + 1.0]))
        np.testing.assert_array_equal(function(POINTS)[0], number * POINTS + 1.0)
    assert len([*folder.iterdir()]) == 1


def test_two_processes_compile_at_once(folder, tmp_path):
    start = str(time.time() + 3.0)
    command = [sys.executable, "-c", PROGRAM, str(folder), text_of(43), start]
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)
    ]
    assert [p.communicate(timeout=60)[0].strip() for p in processes] == ["43"] * 3
    assert all(p.returncode == 0 for p in processes)
    assert all(file.suffix == ".so" for file in folder.iterdir())
    assert all(compiler._is_whole(file) for file in folder.iterdir())


@pytest.mark.parametrize("damage", ["cut", "changed", "empty"])
def test_a_damaged_file_is_compiled_anew(folder, damage):
    load(text_of(44))
    (file,) = folder.iterdir()
    content = bytearray(file.read_bytes())
    half = len(content) // 2
    content[half] ^= 0xFF
    file.unlink()  # this process runs the old one
    file.write_bytes({"cut": content[:half], "changed": content, "empty": b""}[damage])
    forget()
    assert load(text_of(44)).answer() == 44
    assert [compiler._is_whole(f) for f in folder.iterdir()] == [True]


def test_without_a_compiler_the_interpreter_serves(folder, monkeypatch, tmp_path):
    assert runs_compiled()
    forget()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not runs_compiled()


@pytest.mark.parametrize("program", ["exit 1", "echo no library > $OUT", "sleep 60"])
def test_where_the_compiler_fails_the_interpreter_serves(
    folder, monkeypatch, tmp_path, program
):
    """It ends with an error; it writes something else; it does not end."""
    script = tmp_path / "cc"
    find_output = 'while [ "$1" != -o ]; do shift; done; OUT="$2"'
    script.write_text(f"#!/bin/sh\n{find_output}\nexec 2>/dev/null\n{program}\n")
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(
        compiler, "COMPILATION_TIMEOUT", 0.3 if "sleep" in program else 20.0
    )
    assert not runs_compiled()
    assert not [*folder.iterdir()]


def test_a_compiler_that_does_not_know_the_processor_serves(
    folder, monkeypatch, tmp_path
):
    known = compiler.find_compiler(os.environ["PATH"])
    script = tmp_path / "cc"
    script.write_text(
        f'#!/bin/sh\ncase "$*" in *native*) exit 1;; esac\nexec {known.path} "$@"\n'
    )
    script.chmod(0o755)
    forget()
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert runs_compiled()


def test_where_the_folder_cannot_be_the_interpreter_serves(folder, monkeypatch):
    folder.write_text("a file in its place")
    assert not runs_compiled()
    assert folder.read_text() == "a file in its place"


def test_a_folder_that_is_only_read_serves_what_it_has(folder, monkeypatch):
    """Permissions do not stop the administrator: the write itself fails here."""
    assert runs_compiled()

    def refuse(path: Path) -> None:
        raise PermissionError(13, "read-only", str(path))

    monkeypatch.setattr(compiler, "whole_file", refuse)
    forget()
    assert runs_compiled()
    for file in folder.iterdir():
        file.unlink()
    forget()
    assert not runs_compiled()
    assert not [*folder.iterdir()]


@pytest.mark.parametrize("writable", ["compiled", "."])
def test_a_folder_that_others_can_write_or_replace_is_not_used(folder, writable):
    folder.mkdir()
    (folder.parent / writable).chmod(0o777)
    assert not runs_compiled()
    assert not [*folder.iterdir()]


def test_a_compiler_of_the_current_folder_is_not_called(tmp_path, monkeypatch):
    forget()
    script = tmp_path / "cc"
    script.write_text("#!/bin/sh\n", encoding="utf-8")
    script.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    assert compiler.find_compiler(f".{os.pathsep}") is None
    assert compiler.find_compiler(str(tmp_path)) is not None
    forget()


def test_the_folder_stays_small(folder, monkeypatch):
    monkeypatch.setattr(compiler, "MAX_FILES", 2)
    for number in range(4):
        load(text_of(number))
    assert len([*folder.iterdir()]) == 2
    assert load(text_of(0)).answer() == 0  # this process has it still


def test_a_program_that_ends_ends_its_compiler(tmp_path):
    """It does not wait for it, and leaves no file."""
    script = tmp_path / "cc"
    script.write_text("#!/bin/sh\nexec sleep 60\n")
    script.chmod(0o755)
    program = """
import sys, tempfile, time
from pathlib import Path
from oed.mechanism import compiled as compiler
compiler.cache_folder = lambda: Path(sys.argv[1]) / "compiled"
compiler.compiled_text("int answer(void) { return 7; }").make_beside()
while not compiler.child_process._running:
    time.sleep(0.01)
"""
    (tmp_path / "scratch").mkdir()
    paths = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    scratch = {"TMPDIR": str(tmp_path / "scratch")}
    start = time.monotonic()
    subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)],
        env={**os.environ, **paths, **scratch},
        check=True,
        timeout=40.0,
    )
    assert time.monotonic() - start < 30.0
    assert not [*(tmp_path / "scratch").iterdir()]
