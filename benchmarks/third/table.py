"""Figures of the third world beside those of the two other benchmarks' pages."""

from __future__ import annotations

import collections
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import row
from benchmarks.blind.row import Row
from benchmarks.second import score
from benchmarks.second.score import Scored
from benchmarks.third.faults import NEVER_LISTED

DOCS = Path(__file__).resolve().parents[2] / "docs/benchmarks"
PAGE = DOCS / "third.md"
#: between these lines of the page stand the figures
START, END = "% figures", "% end of figures"
NONE_BINS = ((0.0, 0.6), (0.6, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 1.0))
#: the blind benchmark's words for the measures that it has as well
BLIND = {
    "false alarm": "false alarm, all noise laws",
    "detection at sqrt(lambda) 6": "detection at $\\sqrt\\lambda$ 6",
    "detection at sqrt(lambda) 10 and more": "detection at 10 and more",
    "right class": "right class, rivals told apart",
    "mean probability of the true class": "mean probability on the true class",
    "both of two": "both of two, rivals or not",
    "unknown flagged": "unknown effect flagged",
    "known called unknown": "known called unknown alone",
    "95 % set covers": "95 % answer set: coverage",
    "right place": "right leg, run or time block",
}


def records(path: Path) -> list[dict[str, Any]]:
    """Records of a run. Raises OSError, ValueError."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


def write(path: Path, page: Path) -> None:
    """Put the figures of a file of records into a page. Raises OSError, ValueError."""
    text = page.read_text(encoding="utf-8")
    before, start, rest = text.partition(START + "\n")
    _, end, after = rest.partition(END + "\n")
    if not start or not end:
        raise ValueError(f"{page}: has no lines `{START}` and `{END}`; add them")
    figures = markdown(records(path))
    page.write_text(f"{before}{start}\n{figures}\n\n{end}{after}", encoding="utf-8")


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """The tables: measures beside the other pages', and a line for each fault."""
    whole = [r for r in rows if "failure" not in r["result"]]
    scored = [Scored(r["label"], r["result"]) for r in whole]
    if not scored:
        raise ValueError("no case has a diagnosis: run some seeds first")
    seconds = statistics.median(r["seconds"] for r in whole)
    seeds = [r["seed"] for r in rows]
    lines = [
        f"{len(rows)} cases of seeds {min(seeds)} to {max(seeds)},"
        f" {len(rows) - len(whole)} of which the diagnosis could not read;"
        f" {seconds:.1f} s of processor time in the middle.",
        "",
        "| measure | third world | second generator | blind |",
        "|---|---|---|---|",
    ]
    second, blind = _page_table("second.md"), _page_table("blind_results.md")
    for entry in [*score.rows(scored), *_further(scored)]:
        if entry.count:
            title = entry.measure
            blind_cells = blind.get(BLIND.get(title, ""), [])
            cells = _cell(entry), *second.get(title, ["-"])[:1], _joined(blind_cells)
            lines.append(f"| {_formula(title)} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *_by_fault(scored)])


def _further(scored: Sequence[Scored]) -> list[Row]:
    """Answers of no gap by their probability, and how often scatter is the verdict."""
    found = []
    none = [s for s in scored if not s.detected]
    for low, high in NONE_BINS:
        top = high + 1e-9 * (high == 1.0)
        part = [s for s in none if low <= s.probability < top]
        title = f"noise alone, given with {low:g} to {high:g}, that is right"
        found.append(row.share(title, title, [not s.effects for s in part]))
    title = "verdict scatter, of all cases"
    found.append(row.share(title, title, [s.verdict == "scatter" for s in scored]))
    return found


def _by_fault(scored: Sequence[Scored]) -> list[str]:
    """Single faults that can be seen: how many are detected, named, and as what."""
    groups: dict[str, list[Scored]] = collections.defaultdict(list)
    for s in scored:
        if s.kind in ("single", "unknown") and s.total >= score.SIX:
            groups[s.effects[0]["effect"]].append(s)
    lines = [
        "| fault | cases | detected | right | other answers |",
        "|---|---|---|---|---|",
    ]
    for name in sorted(groups, key=lambda n: (n in NEVER_LISTED, n)):
        group = groups[name]
        right = [s for s in group if _is_right(s)]
        others = collections.Counter(
            " + ".join(sorted(s.first)) or s.verdict for s in group if s not in right
        )
        words = ", ".join(f"{what} {n}" for what, n in others.most_common())
        detected = sum(s.detected for s in group)
        title = f"{name} (never listed)" if name in NEVER_LISTED else name
        lines.append(
            f"| {title} | {len(group)} | {detected} | {len(right)} | {words or '-'} |"
        )
    return lines


def _is_right(s: Scored) -> bool:
    if s.kind == "unknown":
        return score.UNKNOWN in s.first
    return s.detected and bool(s.names) and s.names <= s.classes[0]


def _page_table(name: str) -> dict[str, list[str]]:
    """Cells of the tables of a page by their first cell, the first of each."""
    table: dict[str, list[str]] = {}
    for line in (DOCS / name).read_text(encoding="utf-8").splitlines():
        if line.startswith("|"):
            title, *cells = (c.strip() for c in line.strip("|").split("|"))
            table.setdefault(title.replace("$\\sqrt\\lambda$", "sqrt(lambda)"), cells)
            table.setdefault(title, cells)
    return table


def _joined(cells: Sequence[str]) -> str:
    """Result, interval and cases of a row of the blind results."""
    if not cells:
        return "-"
    return f"{cells[0]} ({cells[1]}), {cells[2]}"


def _formula(title: str) -> str:
    return title.replace("sqrt(lambda)", "$\\sqrt\\lambda$")


def _cell(entry: Row) -> str:
    if math.isnan(entry.value):
        return "-"
    interval = f"{entry.low:.2f} to {entry.high:.2f}"
    return f"{entry.value:.2f} ({interval}), n {entry.count}"
