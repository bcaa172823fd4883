"""What holds on Windows: no POSIX-only name, terminals, paths; streams of random numbers."""

import ast
import errno
import itertools
import json
import os
import re
import signal  # noqa: F401 - looked up by name
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import sample
from few_poses import PLAN

import pkm_studies
from pkm_studies import catalogue, console, files
from pkm_studies.base import InputError, Location, Stream
from pkm_studies.commands import main
from pkm_studies.user_code import Origin

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ("oed", "models", "studies", "reports", "benchmarks")
MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios"}
#: names of `os` and `signal` that Windows does not have
NAMES = {
    "os": {
        "chown", "fork", "geteuid", "getloadavg", "getpgid", "getuid", "killpg",
        "mkfifo", "nice", "sched_getaffinity", "setsid", "uname", "wait4",
    },
    "signal": {"SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "alarm", "setitimer"},
}  # fmt: skip
#: any of them, in code or not
NAMED = re.compile(rf"\b({'|'.join(sorted(MODULES | set().union(*NAMES.values())))})\b")


def oed(*arguments: object, encoding: str) -> subprocess.CompletedProcess[bytes]:
    """The command in a process whose terminal has an encoding."""
    return subprocess.run(
        [sys.executable, "-m", "pkm_studies.commands.cli", *map(str, arguments)],
        env=os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
        capture_output=True,
        check=False,
    )


# -- terminals -------------------------------------------------------------------------
def test_a_terminal_without_unicode_gets_the_text(tmp_path):
    """A title with σ, ± and ≤ reaches stdout and stderr, with ? where it must."""
    study = tmp_path / "p.study.toml"
    text = sample.changed(PLAN, ('name = "circles"', 'name = "σ ± ≤"'))
    text = sample.changed(text, ("equals = 18", "equals = 21"))
    study.write_text(text, encoding="utf-8")
    finished = oed("run", study, "--out", tmp_path / "out", encoding="ascii")
    assert finished.returncode == 1, finished.stderr
    assert b"Claim rank: not met" in finished.stdout
    assert b"Traceback" not in finished.stderr
    result = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))
    assert result["plan"]["alternatives"] == ["σ ± ≤"]
    wrong = oed("run", tmp_path / "σ.study.toml", encoding="ascii")
    assert wrong.returncode == 2
    assert b"?.study.toml: there is no such study file" in wrong.stderr


def test_json_is_whole_on_any_terminal():
    arguments = ["list", "effects", "--json"]
    narrow = oed(*arguments, encoding="cp1252")
    wide = oed(*arguments, encoding="utf-8")
    assert narrow.returncode == wide.returncode == 0
    assert json.loads(narrow.stdout.decode("cp1252")) == json.loads(wide.stdout)


# -- names that only POSIX has ---------------------------------------------------------
def test_a_study_runs_without_posix_names(tmp_path, monkeypatch):
    for module, names in NAMES.items():
        for name in names:
            monkeypatch.delattr(sys.modules[module], name, raising=False)
    for module in MODULES:
        monkeypatch.setitem(sys.modules, module, None)
    study = tmp_path / "p.study.toml"
    study.write_text(PLAN, encoding="utf-8")
    assert main(["run", str(study), "--quiet", "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out/result.json").is_file()


def _posix_names(path: Path) -> Iterator[str]:
    """POSIX-only modules imported at module level, and names of `os` and `signal`."""
    text = path.read_text(encoding="utf-8")
    if not NAMED.search(text):
        return
    tree = ast.parse(text)
    for node in tree.body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            yield node.module
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute) or not isinstance(node.value, ast.Name):
            continue
        if node.attr in NAMES.get(node.value.id, ()):
            yield f"{node.value.id}.{node.attr}"


def test_no_module_needs_posix():
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    assert len(paths) > 100
    names = {str(path.relative_to(ROOT)): list(_posix_names(path)) for path in paths}
    assert not {path: used for path, used in names.items() if used}


# -- files and pipes -------------------------------------------------------------------
def test_a_file_that_another_program_has_open_is_named(tmp_path, monkeypatch, capsys):
    """Windows refuses to replace an open file: one line, and the old result stays."""
    study, out = tmp_path / "p.study.toml", tmp_path / "out"
    study.write_text(PLAN, encoding="utf-8")
    assert main(["run", str(study), "--quiet", "--out", str(tmp_path / "first")]) == 0
    old = (tmp_path / "first" / "result.json").read_text(encoding="utf-8")
    files.write_whole(out / "result.json", old)

    def refuse(part: Path, target: Path) -> None:
        raise PermissionError(errno.EACCES, "Access is denied", str(target))

    monkeypatch.setattr(Path, "replace", refuse)
    assert main(["run", str(study), "--quiet", "--out", str(out)]) == 2
    err = capsys.readouterr().err
    assert str(out) in err
    assert "access is denied" in err
    assert "close it in other programs" in err
    assert "no temporary folder takes it either" in err
    (left,) = (path for path in out.iterdir() if path.name.startswith("result"))
    assert left.read_text(encoding="utf-8") == old


def test_a_closed_pipe_is_known_by_its_error(monkeypatch):
    invalid = OSError(errno.EINVAL, "Invalid argument")
    assert console.reader_has_gone(BrokenPipeError())
    assert not console.reader_has_gone(invalid)
    monkeypatch.setattr(console.os, "name", "nt")
    assert console.reader_has_gone(invalid)
    assert not console.reader_has_gone(OSError(errno.EINVAL, "Invalid", "a.csv"))


def test_studies_and_readings_may_have_carriage_returns(tmp_path, capsys):
    study, readings = tmp_path / "a.study.toml", tmp_path / "a.readings.csv"
    study.write_text(sample.STUDY, encoding="utf-8", newline="\r\n")
    readings.write_text(sample.READINGS, encoding="utf-8-sig", newline="\r\n")
    assert main(["check", str(study), str(readings)]) == 1
    assert "3 readings fit the columns of small" in capsys.readouterr().out


def test_a_machine_is_found_on_a_drive(tmp_path):
    """The colon of C: does not end the name of a module."""
    with pytest.raises(InputError, match="does not lie in the folder of the study"):
        catalogue.machine("C:\\machines\\mine.py", Origin(tmp_path), Location("study"))


def test_no_two_streams_have_the_same_numbers():
    """Every name is a member: one that repeats a number would be an alias of another."""
    assert [*Stream.__members__] == [stream.name for stream in Stream]
    first = {name: Stream[name].rng(1).random() for name in Stream.__members__}
    assert len(set(first.values())) == len(first)


def test_streams_of_stages_and_sizes_are_no_streams_of_the_study():
    """NumPy pads keys with zeros, and a size of readings is as small as a stream."""
    keys = [tuple(stream.key(5)) for stream in Stream]
    keys += [(*Stream.PLAN.key(5), 1 + stage) for stage in range(4)]
    keys += [(*Stream.HOW_MANY.key(5), size) for size in range(1, 40)]
    states = [tuple(np.random.SeedSequence(k).generate_state(4)) for k in keys]
    for (one, a), (other, b) in itertools.combinations(
        zip(keys, states, strict=True), 2
    ):
        assert a != b, (one, other)


def test_the_study_s_seed_is_used_through_a_stream_alone():
    folder = Path(pkm_studies.__file__).parents[1]
    plain = re.compile(r"default_rng\([\w.]*(study|result)\.seed\)|int\(Stream\.")
    for path in sorted(folder.rglob("*.py")):
        assert not plain.search(path.read_text(encoding="utf-8")), path
