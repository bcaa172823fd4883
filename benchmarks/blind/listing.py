"""Lists of cases by what is in them, for whoever sets a run up: opens labels, so a
diagnosis must not see it.

    python -m benchmarks.blind list --cases SET --kinds single --least 6 --withhold
    --out WITHHELD

writes a line a case, {"id": ...}; with --withhold each names its effect, to be left out
of the library: {"id": ..., "without": "backlash"}. `run --list` takes them. --apart
keeps the cases whose known effects the readings can test and tell from every rival, for
which it asks the oracle (about two seconds a case).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import entries, loading, measures, oracle, pool


def write(
    folder: Path,
    out: Path,
    *,
    kinds: Sequence[str] = (),
    machines: Sequence[str] = (),
    least: float = 0.0,
    apart: float = 0.0,
    withhold: bool = False,
    workers: int = 0,
) -> int:
    """Write the list of a set's cases of some kinds and machines, severity `least` or
    more, with known effects that are `apart` or more from every rival; how many there
    are.

    Raises ValueError for a kind or machine that no case has, and where no case fits.
    """
    found = entries.labels(folder)
    for option, given, field in (
        ("--kinds", kinds, "kind"),
        ("--machines", machines, "machine"),
    ):
        known = sorted({str(label[field]) for label in found})
        for name in given:
            if name not in known:
                raise ValueError(
                    f"{option} {name}: no case has it; there are {', '.join(known)}"
                )
    kept = []
    for label in found:
        acting = label["effects"]
        if (kinds and label["kind"] not in kinds) or (
            machines and label["machine"] not in machines
        ):
            continue
        if min((e["target"] for e in acting), default=0.0) < least:
            continue
        if withhold and (len(acting) != 1 or acting[0]["unknown"]):
            continue
        kept.append(label)
    if apart > 0.0:
        kept = _apart(folder, kept, apart, workers)
    if not kept:
        raise ValueError(
            "no case fits; ask for more kinds, machines or a lower --least or --apart"
        )
    lines = [
        {"id": v["id"]} | ({"without": v["effects"][0]["name"]} if withhold else {})
        for v in kept
    ]
    loading.write(out, "".join(json.dumps(line) + "\n" for line in lines))
    return len(lines)


def _apart(
    folder: Path, found: Sequence[dict[str, Any]], least: float, workers: int
) -> list[dict[str, Any]]:
    """Labels of the cases with known effects that the readings can test and tell from
    every rival.
    """
    cases = {c.id: c for c in loading.manifest(folder)}
    jobs = [
        oracle.Job(
            folder, folder, cases[v["id"]], tuple(e["name"] for e in v["effects"])
        )
        for v in found
    ]  # nothing is written: the figures of cases without a result are not kept
    told = {
        job.case.id: figures
        for job, figures in pool.results(oracle.distances, jobs, workers=workers)
    }
    made = [entries.entry(v, told[v["id"]], {}) for v in found]
    return [
        dict(e.label)
        for e in made
        if e.known and e.testable and measures.at_least(e.apart, least)
    ]
