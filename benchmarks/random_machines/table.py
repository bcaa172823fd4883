"""False alarms of a file of records, by family, noise and plan, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks.blind.intervals import wilson

Record = Mapping[str, Any]
HEAD = "| | machines | false alarms | 95 % interval |\n| --- | --: | --: | --- |"
#: in which order the parts of the table come, and what they group by
GROUPS: Sequence[tuple[str, Callable[[Record], str]]] = (
    ("machine", lambda r: f"`{r['model']}`"),
    ("noise", lambda r: str(r["law"])),
    ("plan", lambda r: str(r["plan"])),
    ("instruments", lambda r: "one" if len(r["instruments"]) == 1 else "two"),
    ("size", lambda r: _decade(r["size_m"])),
    ("readings", lambda r: "above 150" if _count(r) > 150 else "up to 150"),
)


def is_alarm(record: Record) -> bool:
    """Whether anything but "none" was said of a machine without a gap."""
    return bool(record["verdict"] != "none")


def markdown(records: Sequence[Record]) -> str:
    """The table of all groups."""
    lines = [HEAD, _row("all", records)]
    for _, key in GROUPS:
        for value in sorted({key(r) for r in records}):
            lines.append(_row(value, [r for r in records if key(r) == value]))
    return "\n".join(lines)


def _row(name: str, records: Sequence[Record]) -> str:
    alarms = sum(map(is_alarm, records))
    low, high = wilson(alarms, len(records))
    share = f"{alarms} ({100.0 * alarms / len(records):.1f} %)"
    return (
        f"| {name} | {len(records)} | {share} | {100 * low:.1f}..{100 * high:.1f} % |"
    )


def _decade(size: float) -> str:
    for least in (3.0, 1.0, 0.3):
        if size >= least:
            return f"from {least:g} m"
    return "below 0.3 m"


def _count(record: Record) -> int:
    return int(record["runs"] * record["readings"] * len(record["instruments"]))
