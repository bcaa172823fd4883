"""The table of the second generator: each measure under each noise law."""

from __future__ import annotations

import math
from collections.abc import Sequence

from benchmarks.blind.row import Row
from benchmarks.second import score
from benchmarks.second.cases import Case


def markdown(cases: Sequence[Case], laws: Sequence[str]) -> str:
    """Measures with 95 % intervals and numbers of cases, one column a law.

    Only cases that have a result under every law count.
    """
    done = [c for c in cases if all(c.result(law).is_file() for law in laws)]
    columns = [{r.key: r for r in score.rows(score.load(done, law))} for law in laws]
    keys = list(dict.fromkeys(key for column in columns for key in column))
    lines = [
        f"{len(done)} cases",
        "",
        "| measure | " + " | ".join(f"{law} law" for law in laws) + " |",
        "|---" * (len(laws) + 1) + "|",
    ]
    for key in keys:
        entries = [column.get(key) for column in columns]
        title = next(e.measure for e in entries if e is not None)
        lines.append(f"| {title} | " + " | ".join(map(_cell, entries)) + " |")
    return "\n".join(lines)


def _cell(entry: Row | None) -> str:
    if entry is None or math.isnan(entry.value):
        return "-"
    interval = f"{entry.low:.2f} to {entry.high:.2f}"
    return f"{entry.value:.2f} ({interval}), n {entry.count}"
