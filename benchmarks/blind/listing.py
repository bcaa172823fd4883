"""Lists of cases by what is in them, for whoever sets a run up: opens labels, so a diagnosis must not see it.

    python -m benchmarks.blind list --cases SET --kinds single --least 6 --withhold --out WITHHELD

writes a line a case, {"id": ...}; with --withhold each names its effect, to be left out of the library:
{"id": ..., "without": "backlash"}. `run --list` takes them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.blind import entries, loading


def write(
    folder: Path,
    out: Path,
    *,
    kinds: Sequence[str] = (),
    machines: Sequence[str] = (),
    least: float = 0.0,
    withhold: bool = False,
) -> int:
    """Write the list of a set's cases of some kinds and machines, severity `least` or more; how many there are.

    Raises ValueError for a kind or machine that no case has.
    """
    found = entries.labels(folder)
    for option, given, field in (("--kinds", kinds, "kind"), ("--machines", machines, "machine")):
        known = sorted({str(label[field]) for label in found})
        for name in given:
            if name not in known:
                raise ValueError(f"{option} {name}: no case has it; there are {', '.join(known)}")
    lines = []
    for label in found:
        acting = label["effects"]
        if (kinds and label["kind"] not in kinds) or (machines and label["machine"] not in machines):
            continue
        if min((e["target"] for e in acting), default=0.0) < least:
            continue
        if withhold and (len(acting) != 1 or acting[0]["unknown"]):
            continue
        lines.append(json.dumps({"id": label["id"]} | ({"without": acting[0]["name"]} if withhold else {})))
    if not lines:
        raise ValueError("no case fits; ask for more kinds, machines or a lower --least")
    loading.write(out, "\n".join(lines) + "\n")
    return len(lines)
