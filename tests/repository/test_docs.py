"""The documentation runs: the tutorial as written, and every example of the gallery.

`make docs` builds the site, with warnings as errors: it holds all links within it.
"""

import contextlib
import io
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import warnings
from pathlib import Path
from typing import NamedTuple

import pytest

from pkm_studies.commands import main
from pkm_studies.study import SCHEMAS, Study

DOCS = Path(__file__).resolve().parents[2] / "docs"
TUTORIAL = DOCS / "tutorial_own_machine.md"
#: pages that run from top to bottom, and how many commands they have at least
EXECUTED = {
    "tutorial_own_machine": 9, "tutorial_tripod": 4, "howto/test": 2, "howto/arrays": 1,
    "howto/adjust": 3, "howto/forecast": 3, "howto/rounds": 9,
    "howto/self_calibration": 10,
}  # fmt: skip
#: command of a page from which on it runs at night only, as it takes seconds
LONG_COMMANDS = {
    "howto/forecast": "oed forecast a3_forecast",
    "howto/rounds": "oed identify round1.study.toml",
    "howto/self_calibration": "oed run plates.study.toml",
}
#: pages that run at night only: other tests run their commands on the same study
AT_NIGHT = {"howto/adjust", "howto/test", "tutorial_own_machine", "tutorial_tripod"}
PAGES = [
    *((page, LONG_COMMANDS.get(page, "")) for page in EXECUTED if page not in AT_NIGHT),
    *(
        pytest.param(page, "", marks=pytest.mark.slow)
        for page in [*LONG_COMMANDS, *sorted(AT_NIGHT)]
    ),
]
GALLERY = sorted(
    p for p in (DOCS / "gallery").glob("*.py") if not p.name.startswith("_")
)
LONG = {"a3_gap"}  #: examples that take more than ten seconds
BLOCK = re.compile(r"^```(\w+)(?: file=(\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)\s]*)?\)")
CODE_SPAN = re.compile(r"`[^`\n]+`")
LARGEST = 60_000  # bytes of a picture


class Block(NamedTuple):
    """A fenced block: its language, the file it quotes ("" if none), its text."""

    language: str
    file: str
    text: str


class Command(NamedTuple):
    """A line after `$`, and the lines of its output that the page shows."""

    line: str
    shown: list[str]


def blocks(page: Path) -> list[Block]:
    return [
        Block(*groups) for groups in BLOCK.findall(page.read_text(encoding="utf-8"))
    ]


def commands(console: str) -> list[Command]:
    """The commands of a console block, each with its output."""
    listing: list[Command] = []
    for line in console.splitlines():
        if line.startswith("$ "):
            listing.append(Command(line[2:], []))
        else:
            listing[-1].shown.append(line)
    return listing


def matches(shown: str, line: str) -> bool:
    """`...` in what is shown stands for anything."""
    return (
        re.fullmatch(".*".join(re.escape(part) for part in shown.split("...")), line)
        is not None
    )


def missing(shown: list[str], output: str) -> list[str]:
    """Shown lines that the output does not have, in this order."""
    lines = iter(output.splitlines())
    return [text for text in shown if not any(matches(text, line) for line in lines)]


def execute(line: str, folder: Path) -> str:
    """Output of a command as a user types it.

    A plain `oed` command, or a script, runs in this process, where everything is imported
    already.
    """
    words = line.split()
    if set(line) & set("|&;<>\"'$*?"):
        return execute_by_bash(line, folder)
    if words[0] == "oed":
        return execute_here(words[1:], folder)
    if words[0] == "python" and words[1].endswith(".py"):
        return execute_script(words[1:], folder)
    return execute_by_bash(line, folder)


def execute_here(words: list[str], folder: Path) -> str:
    """Output of the command `oed`, with its exit code 0."""
    stdout, stderr = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        warnings.catch_warnings(),
        contextlib.redirect_stdout(stdout),
        contextlib.redirect_stderr(stderr),
    ):
        warnings.simplefilter("default")  # as in a process of its own
        patch.chdir(folder)
        patch.setenv("COLUMNS", "200")
        code = main(words)
    assert code == 0, f"{words}\n{stdout.getvalue()}\n{stderr.getvalue()}"
    return stdout.getvalue()


def execute_script(words: list[str], folder: Path) -> str:
    """Output of a Python file; the modules beside it are forgotten afterwards."""
    stdout, loaded = io.StringIO(), set(sys.modules)
    with (
        pytest.MonkeyPatch.context() as patch,
        warnings.catch_warnings(),
        contextlib.redirect_stdout(stdout),
    ):
        warnings.simplefilter("default")
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        patch.setattr(sys, "argv", words)
        runpy.run_path(words[0], run_name="__main__")
    for name in set(sys.modules) - loaded:
        origin = getattr(sys.modules[name], "__file__", None)
        if origin and Path(origin).is_relative_to(folder):
            del sys.modules[name]
    return stdout.getvalue()


def execute_by_bash(line: str, folder: Path) -> str:
    """Output of a line for the shell, with this Python first on the path."""
    places = [
        str(Path(sys.executable).parent),
        sysconfig.get_path("scripts"),
        os.environ.get("PATH", ""),
    ]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env=environment | {"PATH": os.pathsep.join(places), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.parametrize(("shown", "line", "same"), [
    ("a ... d", "a b c d", True), ("a", "a b", False), ("1.5...", "1.53 um", True),
    ("[x]", "[x]", True),
])  # fmt: skip
def test_dots_stand_for_anything(shown, line, same):
    assert matches(shown, line) == same


def test_a_missing_line_is_noticed():
    assert missing(["a", "c"], "a\nb\nc") == []
    assert missing(["c", "a"], "a\nb\nc") == ["a"]


def test_the_tutorial_quotes_its_files():
    shown = {b.file: b.text for b in blocks(TUTORIAL) if b.file}
    files = {
        p.name: p.read_text(encoding="utf-8")
        for p in (DOCS / "tutorial").iterdir()
        if p.is_file()
    }
    assert shown == files
    assert len(files["my_machine.py"].splitlines()) < 100


@pytest.mark.skipif(shutil.which("bash") is None, reason="commands are for bash")
@pytest.mark.parametrize(("page", "until"), PAGES)
def test_the_tutorial_runs_as_written(page, until, tmp_path, monkeypatch):
    """By a user who allowed no Python file so far, and trusts no folder."""
    monkeypatch.delenv("OED_TRUSTED_FOLDERS")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    ran = 0
    for block in blocks(DOCS / f"{page}.md"):
        if block.file:
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            for command in commands(block.text):
                if until and command.line.startswith(until):
                    assert ran > 0
                    return
                output = execute(command.line, tmp_path)
                assert not missing(command.shown, output), f"{command.line}\n{output}"
                ran += 1
    assert ran >= EXECUTED[page]
    assert not until, f"{page} has no command {until}"


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in LONG else [])
        for path in GALLERY
    ],
    ids=lambda p: p.stem,
)
def test_gallery(path, tmp_path, monkeypatch):
    """Each example runs, its asserts hold, and it writes its picture into a folder."""
    monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
    monkeypatch.syspath_prepend(str(path.parent))
    runpy.run_path(str(path), run_name="__main__")
    picture = tmp_path / f"{path.stem}.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size < LARGEST
    assert "assert " in path.read_text(encoding="utf-8")


def test_every_example_is_in_the_gallery_with_its_picture():
    page = (DOCS / "gallery" / "index.md").read_text(encoding="utf-8")
    for path in GALLERY:
        assert f"({path.name})" in page
        assert f"(../img/gallery/{path.stem}.png)" in page
        assert (DOCS / "img" / "gallery" / f"{path.stem}.png").stat().st_size < LARGEST


@pytest.mark.parametrize(
    "name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"]
)
def test_links_of_pages_outside_the_site_lead_somewhere(name):
    page = DOCS.parent / name
    prose = BLOCK.sub("", page.read_text(encoding="utf-8"))
    dead = [link for link in LINK.findall(prose) if not (page.parent / link).exists()]
    assert not dead


def test_every_test_that_the_errata_name_exists():
    page = (DOCS / "errata.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(tests/\S+?\.py)::(\w+)`", page))
    assert len(named) > 20
    missing_tests = [
        f"{path}::{name}"
        for path, name in sorted(named)
        if f"def {name}(" not in (DOCS.parent / path).read_text(encoding="utf-8")
    ]
    assert not missing_tests


# -- fields of a study -----------------------------------------------------------------
def pages() -> list[Path]:
    """The pages that somebody wrote."""
    written_by_sphinx = {DOCS / "reference" / "generated", DOCS / "reference" / "api"}
    return [
        page for page in DOCS.rglob("*.md") if not written_by_sphinx & {*page.parents}
    ]


def code_of(page: Path) -> str:
    """What a page writes as code, in blocks and within sentences."""
    text = page.read_text(encoding="utf-8")
    fenced = [block.text for block in blocks(page)]
    return "\n".join([*fenced, *CODE_SPAN.findall(BLOCK.sub("", text))])


def test_each_field_of_a_study_stands_on_a_page():
    words = set(re.findall(r"\w+", "\n".join(code_of(page) for page in pages())))
    tables = SCHEMAS["study"]()["$defs"]
    fields = {
        f"{table}.{field}"
        for table, definition in tables.items()
        for field in definition.get("properties", {})
    }
    absent = {name for name in fields if name.partition(".")[2] not in words}
    assert not absent


#: what an example leaves out of its study
REST = {
    "schema": 1,
    "name": "example",
    "setup": [{"name": "cup", "instrument": "ball_bar"}],
}


def test_examples_are_tables_of_a_study():
    tables = SCHEMAS["study"]()["$defs"]["StudyFile"]["properties"]
    read = 0
    for page in pages():
        for block in blocks(page):
            if block.language != "toml" or block.file:
                continue
            example = tomllib.loads(block.text)
            if example.keys() <= tables.keys():
                machine = {"model": "a3_head"} | example.pop("machine", {})
                Study.from_tables(REST | example | {"machine": machine}, page.parent)
                read += 1
    assert read > 20
