"""What virtual machines show: coverage and accuracy by combination, with figures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from pkm_campaign.tables import Campaign
from pkm_reports import style, text
from pkm_reports.blocks import (
    Block,
    Picture,
    Section,
    Table,
    TableColumn,
    number_columns,
)

# Figures of campaigns: coverage by combination.

#: what 95 % intervals should hold
NOMINAL = 0.95
#: inches of a row, of the axis below, and of the name beside
ROW, AXIS, NAME_LENGTH = 0.28, 0.8, 40


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
    axes.axvline(NOMINAL, color="0.5", linewidth=0.8)
    axes.set_yticks(range(len(rows)), [style.label(n, NAME_LENGTH) for n in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("share of 95 % intervals that hold the truth")
    return drawn


Rows = list[dict[str, Any]]


def chapters(campaign: Campaign, rows: Rows) -> list[Section]:
    """Intervals and accuracy."""
    accuracy = "Accuracy after compensation"
    return [
        Section("intervals", "Intervals", _intervals(campaign, rows)),
        Section("accuracy", accuracy, _accuracy(campaign, rows)),
    ]


def sentences(campaign: Campaign, rows: Rows) -> list[str]:
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
        *number_columns(
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
            _figure(row, "inside_95"),
            f"{_figure(row, 'inside_95_low')} to {_figure(row, 'inside_95_high')}",
            _figure(row, "nees"),
            _figure(row, "not_trusted"),
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
        columns += number_columns(f"{component} [{symbol}]", "over predicted")
    cells = []
    for row in rows:
        line = [campaign.words(row)]
        for name in names:
            line.append(_figure(row, f"realised_{name}"))
            line.append(text.number(_ratios(row).get(name, math.nan)))
        cells.append(line)
    caption = (
        "Realised rms error over the workspace after compensation, over all machines, and"
        " its ratio to the predicted one."
    )
    return [Table(columns, cells, caption)]


def _figure(row: dict[str, Any], key: str) -> str:
    return text.number(float(row.get(key, math.nan)))
