"""Runs the other packages of the design benchmark, each in an environment of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from design_table import Row
from peers import PEERS, Task, value

HERE = Path(__file__).resolve().parent


def interpreter(folder: Path, name: str) -> Path:
    """Python of a package's environment."""
    return folder / name / "bin" / "python"


def install(folder: Path, names: list[str]) -> None:
    """Creates one environment for each package; removes those that fail to install."""
    for name in names:
        requirements = PEERS[name].requires
        steps = _install_steps(folder, name, requirements)
        done = all(subprocess.run(step, check=False).returncode == 0 for step in steps)
        if not done:
            shutil.rmtree(folder / name, ignore_errors=True)
        outcome = "installed" if done else "could not be installed"
        print(f"{name:18s} {outcome}: {' '.join(requirements)}", flush=True)


def _install_steps(
    folder: Path, name: str, requirements: tuple[str, ...]
) -> list[list[str]]:
    """Commands that create the environment, with uv where it is there."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    uv = shutil.which("uv", path=path)
    environment, python = str(folder / name), str(interpreter(folder, name))
    if uv is None:
        return [
            [sys.executable, "-m", "venv", "--clear", environment],
            [python, "-m", "pip", "install", "--quiet", *requirements],
        ]
    create = [uv, "venv", "--quiet", "--clear", "--python", sys.executable]
    fill = [uv, "pip", "install", "--quiet", "--python", python]
    return [[*create, environment], [*fill, *requirements]]


def run_task(folder: Path, name: str, number: int, task: Task, limit: float) -> Row:
    """One task of one package, in its environment."""
    package = name.replace("_", "-")
    method = f"{package}, {task.method}"
    python = interpreter(folder, name)
    if not python.exists():
        return Row(task.problem, method, note="skipped: not installed")
    try:
        # wait for each one: nothing of it may run beside the next
        finished = subprocess.run(
            [python, "-m", "peers", name, str(number)],
            cwd=HERE,
            capture_output=True,
            text=True,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        return Row(task.problem, method, note=f"stopped after {limit:.0f} s")
    if finished.returncode:
        errors = finished.stderr.strip().splitlines() or ["no message"]
        return Row(task.problem, method, note=f"failed: {errors[-1][:80]}")
    answer = json.loads(finished.stdout)
    reached, violations = value(task.problem, answer["indices"])
    return Row(
        task.problem,
        f"{package} {answer['version']}, {task.method}",
        reached,
        answer["seconds"],
        note="; ".join(part for part in (violations, task.note) if part),
    )


def run_all(folder: Path, limit: float, names: list[str]) -> list[Row]:
    """All tasks of these packages."""
    rows = []
    for name in names:
        for number, task in enumerate(PEERS[name].tasks):
            rows.append(run_task(folder, name, number, task, limit))
            print(f"  {rows[-1].method}", file=sys.stderr, flush=True)
    return rows
