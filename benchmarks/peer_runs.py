"""Runs the other packages of the design benchmark, each in an environment of its own."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.peers import PEERS, Task, value

HERE = Path(__file__).resolve().parent


class Result(NamedTuple):
    """What a method reaches on a problem."""

    problem: str
    method: str
    #: criterion value; None where there is no result, and `note` says why
    value: float | None = None
    seconds: float | None = None  #: processor time of the choice
    bound: float | None = None  #: upper bound of the value, where the method gives one
    note: str = ""

    @property
    def rank_value(self) -> float:
        """The value for comparisons; -inf where there is none."""
        return -np.inf if self.value is None else self.value


def interpreter(folder: Path, name: str) -> Path:
    """Python of a package's environment."""
    return folder / name / "bin" / "python"


def install(folder: Path) -> None:
    """Creates one environment for each package; removes those that fail to install."""
    for name, peer in PEERS.items():
        environment, python = folder / name, str(interpreter(folder, name))
        create = [sys.executable, "-m", "venv", "--clear", str(environment)]
        fill = [python, "-m", "pip", "install", "--quiet", *peer.requires]
        steps = (create, fill)
        done = all(subprocess.run(step, check=False).returncode == 0 for step in steps)
        if not done:
            shutil.rmtree(environment, ignore_errors=True)
        outcome = "installed" if done else "could not be installed"
        print(f"{name:18s} {outcome}: {' '.join(peer.requires)}", flush=True)


def run_task(folder: Path, name: str, number: int, task: Task, limit: float) -> Result:
    """One task of one package, in its environment."""
    method = f"{name}, {task.method}"
    python = interpreter(folder, name)
    if not python.exists():
        return Result(task.problem, method, note="skipped: not installed")
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
        return Result(task.problem, method, note=f"stopped after {limit:.0f} s")
    if finished.returncode:
        errors = finished.stderr.strip().splitlines() or ["no message"]
        return Result(task.problem, method, note=f"failed: {errors[-1][:80]}")
    answer = json.loads(finished.stdout)
    reached, violations = value(task.problem, answer["indices"])
    method = f"{name} {answer['version']}, {task.method}"
    note = "; ".join(part for part in (violations, task.note) if part)
    return Result(task.problem, method, reached, answer["seconds"], note=note)


def run_all(folder: Path, limit: float) -> list[Result]:
    """All tasks of all packages."""
    results = []
    for name, peer in PEERS.items():
        for number, task in enumerate(peer.tasks):
            results.append(run_task(folder, name, number, task, limit))
            print(f"  {results[-1].method}", file=sys.stderr, flush=True)
    return results
