"""Lists of cases by their labels, for the campaign; a diagnosis must not see this.

    python -m benchmarks.blind list --cases SET --kinds single --least 6 --withhold \\
        --out withheld.jsonl

writes a line a case, {"id": ...}. With --withhold each names its effect, to be withheld
from the library: {"id": ..., "without": "backlash"}. --apart selects the cases whose
known effects the readings test and separate from every rival, by the oracle's figures
(about two seconds a case).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import entries, loading, oracle
from benchmarks.blind.selection import reaches
from pkm_campaign import jobs as pool


def write(
    folder: Path,
    out: Path,
    *,
    kinds: Sequence[str] = (),
    machines: Sequence[str] = (),
    least: float = 0.0,
    apart: float = 0.0,
    withhold: bool = False,
    or_none: bool = False,
    workers: int = 0,
) -> int:
    """Write the list of some of a set's cases; how many there are.

    kinds, machines    only these
    least              least severity
    apart              least separation of known effects from every rival
    withhold           name the effect to withhold in each line
    or_none            whether the list may be empty

    Raises ValueError for a kind or machine that no case has, and where no case fits.
    """
    labels = entries.labels(folder)
    _check("--kinds", kinds, [str(label["kind"]) for label in labels])
    _check("--machines", machines, [str(label["machine"]) for label in labels])
    selected = []
    for label in labels:
        acting = label["effects"]
        if kinds and label["kind"] not in kinds:
            continue
        if machines and label["machine"] not in machines:
            continue
        if min((e["target"] for e in acting), default=0.0) < least:
            continue
        if withhold and (len(acting) != 1 or acting[0]["unknown"]):
            continue
        selected.append(label)
    if apart > 0.0:
        selected = _separated(folder, selected, apart, workers)
    if not (selected or or_none):
        raise ValueError(
            "no case fits; ask for more kinds, machines or a lower --least or --apart"
        )
    lines = []
    for label in selected:
        line = {"id": label["id"]}
        if withhold:
            line["without"] = label["effects"][0]["name"]
        lines.append(json.dumps(line) + "\n")
    loading.write(out, "".join(lines))
    return len(lines)


def _check(option: str, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            there = ", ".join(sorted(set(known)))
            raise ValueError(f"{option} {name}: no case has it; there are {there}")


def _separated(
    folder: Path,
    labels: Sequence[dict[str, Any]],
    least: float,
    workers: int,
) -> list[dict[str, Any]]:
    """Labels of the cases whose known effects the readings test and separate.

    From every rival, by `least` or more.
    """
    cases = {c.id: c for c in loading.manifest(folder)}
    jobs = []
    for label in labels:
        acting = tuple(e["name"] for e in label["effects"])
        jobs.append(oracle.OracleJob(folder, cases[label["id"]], acting))
    results = pool.pool_results(oracle.distances, jobs, workers=workers)
    figures = {job.case.id: distances for job, distances in results}
    every = [entries.entry(label, figures[label["id"]], {}) for label in labels]
    testable = [e for e in every if e.known and e.testable]
    return [dict(e.label) for e in testable if reaches(e.separation, least)]
