"""Many virtual machines, one small file each, so that a broken run goes on."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.coverage.configurations import configuration
from benchmarks.coverage.measure import one_machine


def run(
    folder: Path,
    names: Sequence[str],
    laws: Sequence[str],
    machines: int,
    seed: int,
    report: Callable[[str], None] = print,
) -> None:
    """Measure every machine of every cell that has no file in the folder yet."""
    for name in names:
        for law in laws:
            for number in range(machines):
                path = result_file(folder, name, law, seed, number)
                if not path.is_file():
                    _measure(path, name, law, number, seed)
            report(f"{name}, {law}: {machines} machines")


def result_file(folder: Path, name: str, law: str, seed: int, number: int) -> Path:
    """Where the result of a machine is."""
    return folder / f"seed_{seed}" / name / law / f"{number:04d}.json"


def _measure(path: Path, name: str, law: str, number: int, seed: int) -> None:
    bench = configuration(name)
    begin = time.process_time()
    outcome = one_machine(bench, law, number, seed).as_json()
    outcome["cpu_s"] = round(time.process_time() - begin, 3)
    store(path, outcome)


def store(path: Path, result: Mapping[str, Any]) -> None:
    """Write a machine's result, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(result), encoding="utf-8")
    part.replace(path)


def load(
    folder: Path, name: str, law: str, seed: int, machines: int
) -> list[dict[str, Any]]:
    """The results of a cell's machines, as far as they are there."""
    paths = [result_file(folder, name, law, seed, k) for k in range(machines)]
    return [json.loads(p.read_text(encoding="utf-8")) for p in paths if p.is_file()]
