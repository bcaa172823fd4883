"""Diagnosis of random machines, one record a machine."""

from __future__ import annotations

import json
import tempfile
import time
import traceback
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.random_machines import case as cases
from benchmarks.random_machines.case import Case
from oed import build_study, diagnose, identify, read_readings

#: verdict where the check of the readings takes a clean machine's for mistaken
MISTAKEN, FAILED = "mistaken", "failed"


def answer(case: Case) -> dict[str, Any]:
    """What the diagnosis of a case says: verdict, answers, and the fit it starts from."""
    with tempfile.TemporaryDirectory() as folder:
        path = cases.write(case, Path(folder))
        readings = read_readings(build_study(case.study, folder), path)
        estimate = identify(readings)
        state = diagnose(estimate).state
    fit, gap = state.estimate, state.result.gap
    record = {"chi2": float(fit.chi2), "dof": float(fit.dof)}
    if gap is None:
        return record | {"verdict": MISTAKEN, "words": list(state.warnings)}
    return record | {
        "verdict": gap.verdict,
        "answers": [[a.effects, round(a.probability, 4)] for a in gap.answers[:5]],
        "noise": list(gap.noise),
        "unknown": gap.unknown,
    }


def record(number: int, seed: int) -> dict[str, Any]:
    """The record of one machine; a diagnosis that fails leaves its traceback."""
    begin = time.process_time()
    case = cases.draw(number, seed)
    facts = {"number": number, "seed": seed, **case.facts}
    try:
        facts |= answer(case)
    except Exception:  # whatever fails is a defect to be read in the record
        facts |= {"verdict": FAILED, "traceback": traceback.format_exc()}
    return facts | {"cpu_s": round(time.process_time() - begin, 1)}


def run(numbers: Iterable[int], seed: int, path: Path) -> None:
    """Diagnose the machines that a file of records does not have yet."""
    present = {(r["seed"], r["number"]) for r in load(path)} if path.exists() else set()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        for number in numbers:
            if (seed, number) in present:
                continue
            made = record(number, seed)
            file.write(json.dumps(made) + "\n")
            file.flush()
            print(_line(made), flush=True)


def load(path: Path) -> list[dict[str, Any]]:
    """All records of a file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _line(made: Mapping[str, Any]) -> str:
    parts = ("number", "model", "law", "plan", "verdict", "cpu_s")
    return "  ".join(str(made[part]) for part in parts)
