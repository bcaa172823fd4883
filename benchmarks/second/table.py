"""The table of the second generator: each measure under each noise law."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.blind.row import Row
from benchmarks.second import cases, score
from benchmarks.second.run import LAWS
from benchmarks.second.score import Scored
from pkm_campaign import read_row

#: (machine, name) of a case
Key = tuple[str, str]


def markdown(campaign: Path) -> str:
    """Measures with 95 % intervals and numbers of cases, one column a law.

    `campaign` is the folder of its cases. Only those with a diagnosis under every law
    that the campaign had count. Raises ValueError where there is none, OSError.
    """
    by_law = {
        law: diagnosed for law, diagnosed in _diagnosed(campaign).items() if diagnosed
    }
    first = next(iter(by_law.values()), {})
    done = [
        key for key in first if all(key in diagnosed for diagnosed in by_law.values())
    ]
    if not done:
        raise ValueError(
            f"{campaign}: no case has a diagnosis under every law; run `oed campaign"
            " benchmarks/second.campaign.toml` first"
        )
    columns = [
        {r.key: r for r in score.rows([diagnosed[key] for key in done])}
        for diagnosed in by_law.values()
    ]
    keys = list(dict.fromkeys(key for column in columns for key in column))
    lines = [
        f"{len(done)} cases",
        "",
        "| measure | " + " | ".join(f"{law} law" for law in by_law) + " |",
        "|---" * (len(by_law) + 1) + "|",
    ]
    for key in keys:
        entries = [column.get(key) for column in columns]
        title = next(e.measure for e in entries if e is not None)
        lines.append(f"| {title} | " + " | ".join(map(cell, entries)) + " |")
    return "\n".join(lines)


def _diagnosed(campaign: Path) -> dict[str, dict[Key, Scored]]:
    """Diagnoses under each law, with the labels of their cases."""
    labels: dict[tuple[str, str], dict[str, Any]] = {}
    by_law: dict[str, dict[Key, Scored]] = {law: {} for law in LAWS}
    for path in sorted((campaign / "cases").glob("*.json")):
        row: Mapping[str, Any] = read_row(path)
        place = row["folder"], row["machine"]
        if place not in labels:
            labels[place] = cases.labels(Path(row["folder"]), row["machine"])
        label = labels[place][row["case"]]
        by_law[row["law"]][row["machine"], row["case"]] = Scored(label, row)
    return by_law


def cell(entry: Row | None) -> str:
    """A measure with its interval and number of cases."""
    if entry is None or math.isnan(entry.value):
        return "-"
    interval = f"{entry.low:.2f} to {entry.high:.2f}"
    return f"{entry.value:.2f} ({interval}), n {entry.count}"
