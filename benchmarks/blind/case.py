"""Cases of the campaign `blind`: the diagnosis of one case of a set, without its labels.

    PYTHONPATH=. oed campaign --allow-code benchmarks/blind.campaign.toml

A setting names the folder of the sets and a part of the benchmark; the seed is the
case's number in its set. A part may be a list of some of the cases: `list` writes it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.blind import loading, run
from benchmarks.blind.run import DiagnosisJob

if TYPE_CHECKING:
    import pandas as pd

#: set of each part, and the list of its cases; none for all of them
ALL, WITHHELD, PAIRS = "all", "withheld", "pairs"
PARTS = {
    ALL: ("set", ""),
    WITHHELD: ("set", "withheld.jsonl"),
    PAIRS: ("pairs", "separated.jsonl"),
}
#: whether a case belongs to its part
DIAGNOSED = "diagnosed"


def diagnosis(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """The record of a case's diagnosis, see `run`.

    setting  folder of the sets, and part
    """
    return record_of(setting, seed, run.work)


def record_of(
    setting: Mapping[str, Any],
    seed: int,
    work: Callable[[DiagnosisJob], dict[str, Any]],
) -> dict[str, Any]:
    """What `work` returns for a case, if that belongs to its part.

    Raises ValueError, OSError where sets or lists are missing.
    """
    job = job_of(Path(setting["folder"]), str(setting["part"]), seed)
    return {DIAGNOSED: False} if job is None else {DIAGNOSED: True, **work(job)}


def job_of(folder: Path, part: str, number: int) -> DiagnosisJob | None:
    """The job of a case by number, with the effect to withhold; None if not listed.

    Raises ValueError for an unknown part, and as `loading.numbered` does.
    """
    if part not in PARTS:
        raise ValueError(f"part {part}: there are {', '.join(PARTS)}")
    name, listed = PARTS[part]
    case = loading.numbered(folder / name, number)
    if not listed:
        return DiagnosisJob(folder / name, case)
    for line in (folder / listed).read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if entry["id"] == case.id:
            return DiagnosisJob(folder / name, case, entry.get("without", ""))
    return None


def verdicts(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, Any]:
    """How many diagnoses there are, how many failed, and what the others say."""
    done = cases[cases[DIAGNOSED]]
    return {"diagnoses": len(done), **run.verdict_counts(done)}
