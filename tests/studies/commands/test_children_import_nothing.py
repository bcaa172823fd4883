"""No command imports what lies in the current folder, nor does a process that it starts.

Beside the study lie files with the names of all modules of Python and of all packages that
are installed. Each leaves its name in a file where it runs.
"""

import ast
import importlib.metadata
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sample
from page import page_server

from oed import child_process
from pkm_page import BackgroundCommand

ROOT = Path(__file__).resolve().parents[3]
#: as the script that pip installs; its folder takes the place of the current one
SCRIPT = """\
import sys
from pkm_studies.commands.cli import main
if __name__ == "__main__":
    sys.exit(main())
"""
CAMPAIGN = [
    "campaign", "own.campaign.toml", "--workers", "2", "--allow-code", "--quiet",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study among traps, and the script in another folder."""
    folder = tmp_path_factory.mktemp("study")
    (folder.parent / "oed_script.py").write_text(SCRIPT, encoding="utf-8")
    text = page_server.STUDY + "\n[posterior]\nenabled = false\n"
    (folder / "s.study.toml").write_text(text, encoding="utf-8")
    sample.write_campaign(folder, [1, 2])
    trap = f"with open({str(folder / 'ran')!r}, 'a') as f: f.write(__name__ + ' ')\n"
    for name in names():
        (folder / f"{name}.py").write_text(trap, encoding="utf-8")
    return folder


def names() -> Iterator[str]:
    """Modules that something might import."""
    yield from sys.stdlib_module_names
    yield from importlib.metadata.packages_distributions()


def ran(folder: Path) -> str:
    """The traps that ran so far."""
    marks = folder / "ran"
    return marks.read_text(encoding="utf-8") if marks.exists() else ""


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(folder.parent / "oed_script.py"), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_traps_snap(folder):
    """Python does import from the current folder, where nothing prevents it."""
    command = [sys.executable, "-c", "import pickle"]
    subprocess.run(command, cwd=folder, capture_output=True, check=False)
    assert "pickle" in ran(folder)
    (folder / "ran").unlink()


@pytest.mark.parametrize("command", [["list", "machines"], CAMPAIGN])
def test_a_command_imports_nothing_of_the_current_folder(folder, command):
    """One that computes here, and one that starts processes."""
    done = call(folder, *command)
    assert ran(folder) == ""
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr


def test_the_page_s_commands_import_nothing_of_the_current_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)
    job = BackgroundCommand()
    job.start("list", ["list", "criteria"])
    while job.state.runs:
        time.sleep(0.02)
    assert job.state.code == 0, job.state.lines
    assert ran(folder) == ""


def test_processes_are_started_in_one_place():
    """So that what is safe there is safe everywhere."""
    starters = {"subprocess", "multiprocessing", "concurrent.futures.process", "pty"}
    allowed = Path(child_process.__file__)
    folders = [ROOT / name for name in ("oed", "models", "studies", "reports")]
    for path in (file for folder in folders for file in folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if path == allowed or not any(word in text for word in (*starters, "os.")):
            continue
        for node in ast.walk(ast.parse(text)):
            assert not starts_process(node, starters), f"{path}:{node.lineno}"


def starts_process(node: ast.AST, starters: set[str]) -> bool:
    """Whether a node starts a process: types, errors and the parent's handle do not."""
    if not isinstance(node, ast.Attribute) or not isinstance(node.value, ast.Name):
        return False
    harmless = {"SubprocessError", "parent_process", "CompletedProcess"}
    if node.value.id in starters:
        return node.attr not in harmless
    starting = ("system", "popen", "spawn", "exec", "posix_spawn", "fork", "startfile")
    return node.value.id == "os" and node.attr.startswith(starting)
