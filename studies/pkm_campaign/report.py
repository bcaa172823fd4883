"""The report of a campaign: what its cases show, by combination."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

import oed
from pkm_campaign.tables import Campaign
from pkm_reports import style, text
from pkm_reports.blocks import Block, Code, Items, Picture, Section, Table, TableColumn
from pkm_reports.page import Content, Document

if TYPE_CHECKING:
    import pandas as pd

# Figures of campaigns: coverage by combination.

#: what 95 % intervals should hold
NOMINAL_COVERAGE = 0.95
#: height of a row, inches
ROW = 0.28
#: height of the axis below the rows, inches
AXIS = 0.8
#: characters of the name beside a row
NAME_LENGTH = 40


@dataclasses.dataclass(frozen=True, slots=True)
class Coverage:
    """Share of intervals that hold the truth, with its interval (NaN without one)."""

    share: float
    low: float
    high: float


def draw_coverage(rows: Mapping[str, Coverage]) -> Figure:
    """Coverage with its interval, a row each combination."""
    if not rows:
        return style.empty("no machine could be fitted")
    drawn = style.figure(AXIS + ROW * len(rows))
    axes = drawn.subplots()
    for k, row in enumerate(rows.values()):
        if not math.isnan(row.low):
            axes.plot([row.low, row.high], [k, k], color="C0", linewidth=1.5)
        axes.plot(row.share, k, "o", color="C0", markersize=4)
    axes.axvline(NOMINAL_COVERAGE, color="0.5", linewidth=0.8)
    axes.set_yticks(range(len(rows)), [style.label(n, NAME_LENGTH) for n in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("share of 95 % intervals that hold the truth")
    return drawn


# What virtual machines show: coverage and accuracy by combination, with figures.


def machine_chapters(campaign: Campaign, rows: Rows) -> list[Section]:
    """Intervals and accuracy."""
    accuracy = "Accuracy after compensation"
    return [
        Section("intervals", "Intervals", _intervals(campaign, rows)),
        Section("accuracy", accuracy, _accuracy(campaign, rows)),
    ]


def machine_sentences(campaign: Campaign, rows: Rows) -> list[str]:
    """What a summary says, the most important first."""
    failed = sum(int(row["failed"]) for row in rows)
    count = sum(int(row["cases"]) for row in rows)
    lines = [
        f"{count} virtual machines in {len(rows)} combinations; {failed} could not be"
        " fitted."
    ]
    fitted = [row for row in rows if not math.isnan(row.get("inside_95", math.nan))]
    if not fitted:
        return lines
    least = min(fitted, key=lambda row: row["inside_95"])
    most = max(fitted, key=lambda row: row["inside_95"])
    lines.append(
        "95 % intervals of identifiable combinations hold the truth in"
        f" {least['inside_95']:.3f} ({campaign.words(least)}) to"
        f" {most['inside_95']:.3f} ({campaign.words(most)}) of the cases."
    )
    ratios = [ratio for row in fitted for ratio in _ratios(row).values()]
    if ratios:
        lines.append(
            f"Realised over predicted rms error: {min(ratios):.2f} to {max(ratios):.2f}."
        )
    return lines


def _ratios(row: dict[str, Any]) -> dict[str, float]:
    """Realised over predicted rms error, by component with its unit."""
    ratios = {}
    for column, predicted in row.items():
        if not column.startswith("predicted_") or not predicted > 0.0:
            continue
        name = column.removeprefix("predicted_")
        ratios[name] = row[f"realised_{name}"] / predicted
    return ratios


def _intervals(campaign: Campaign, rows: Rows) -> list[Block]:
    columns = [
        TableColumn("Combination"),
        *TableColumn.numbers(
            "machines",
            "not fitted",
            "inside 95 %",
            "its interval",
            "NEES",
            "not trusted",
        ),
    ]
    cells = [
        [
            campaign.words(row),
            str(row["cases"]),
            str(row["failed"]),
            _machine_figure(row, "inside_95"),
            f"{_machine_figure(row, 'inside_95_low')} to {_machine_figure(row, 'inside_95_high')}",
            _machine_figure(row, "nees"),
            _machine_figure(row, "not_trusted"),
        ]
        for row in rows
    ]
    caption = (
        "Share of 95 % intervals of identifiable combinations that hold the truth; mean"
        " squared error over its predicted covariance (NEES, 1 where it is right); share"
        " of machines whose fit is not to be trusted."
    )
    named = {
        campaign.words(row): Coverage(
            row["inside_95"], row["inside_95_low"], row["inside_95_high"]
        )
        for row in rows
        if not math.isnan(row.get("inside_95", math.nan))
    }
    drawn = "Coverage by combination, with its 95 % interval; the line is 0.95."
    return [
        Table(columns, cells, caption),
        Picture("coverage", lambda: draw_coverage(named), drawn),
    ]


def _accuracy(campaign: Campaign, rows: Rows) -> list[Block]:
    names = list(dict.fromkeys(n for row in rows for n in _ratios(row)))
    columns = [TableColumn("Combination")]
    for name in names:
        component, _, unit = name.rpartition("_")
        symbol = text.unit_symbol(unit)
        columns += TableColumn.numbers(f"{component} [{symbol}]", "over predicted")
    cells = []
    for row in rows:
        line = [campaign.words(row)]
        for name in names:
            line.append(_machine_figure(row, f"realised_{name}"))
            line.append(text.number(_ratios(row).get(name, math.nan)))
        cells.append(line)
    caption = (
        "Realised rms error over the workspace after compensation, over all machines, and"
        " its ratio to the predicted one."
    )
    return [Table(columns, cells, caption)]


def _machine_figure(row: dict[str, Any], key: str) -> str:
    return text.number(float(row.get(key, math.nan)))


# What the cases of a user's function show: its summary, by combination.

Rows = list[dict[str, Any]]
#: columns of figures that a table holds beside those of the cases
MAX_FIGURE_COLUMNS = 6


def function_chapters(campaign: Campaign, rows: Rows) -> list[Section]:
    """Tables of the summary; wide ones in parts."""
    names = [
        name
        for name in dict.fromkeys(name for row in rows for name in row)
        if name not in campaign.vary and name not in ("cases", "failed")
    ]
    parts = [
        names[i : i + MAX_FIGURE_COLUMNS]
        for i in range(0, len(names), MAX_FIGURE_COLUMNS)
    ] or [[]]
    tables = [_table(campaign, rows, part) for part in parts]
    return [Section("summary", "Summary", tables)]


def _table(campaign: Campaign, rows: Rows, names: list[str]) -> Table:
    columns = [
        TableColumn("Combination"),
        *TableColumn.numbers("cases", "failed", *names),
    ]
    cells = []
    for row in rows:
        counts = [str(row["cases"]), str(row["failed"])]
        figures = [_figure(row.get(name, math.nan)) for name in names]
        cells.append([campaign.words(row), *counts, *figures])
    return Table(columns, cells, "Figures of all cases of a combination.")


def _figure(value: Any) -> str:
    return value if isinstance(value, str) else text.number(float(value))


def write_report(
    campaign: Campaign, summary: pd.DataFrame, out: Path
) -> tuple[Path, ...]:
    """Write `report.html` and `report.pdf` of a campaign's summary; their paths."""
    rows = _rows(summary)
    count = sum(int(row["cases"]) for row in rows)
    if campaign.varied is None:
        machine, asked = "", f"{count} cases of {campaign.case}"
        chapters = function_chapters(campaign, rows)
    else:
        machine = campaign.varied.machine.model
        asked = f"{count} virtual machines of {campaign.varied.name}"
        chapters = machine_chapters(campaign, rows)
    blocks = [Items(sentences(campaign, summary))]
    content = Content(
        title=campaign.title or f"Campaign {campaign.name}",
        question=f"What do {asked} show?",
        study=campaign.name,
        machine=machine,
        foot=f"{campaign.name} · pkm-oed {oed.__version__}",
        answer=[Section("found", "What the cases show", blocks)],
        chapters=chapters,
        appendix=[Section("file", "Campaign file", [Code(campaign.text)])],
    )
    return Document(content).write(out, "report")


def sentences(campaign: Campaign, summary: pd.DataFrame) -> list[str]:
    """What a summary says, the most important first."""
    rows = _rows(summary)
    if campaign.varied is None:
        failed = sum(int(row["failed"]) for row in rows)
        count = sum(int(row["cases"]) for row in rows)
        return [f"{count} cases in {len(rows)} combinations; {failed} failed."]
    return machine_sentences(campaign, rows)


def _rows(summary: pd.DataFrame) -> Rows:
    return [{str(k): v for k, v in row.items()} for row in summary.to_dict("records")]
