"""What virtual machines show: coverage and accuracy by combination, with figures."""

from __future__ import annotations

import math
from typing import Any

from pkm_campaign import coverage_figure as figures
from pkm_campaign.tables import Campaign
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Picture,
    Section,
    Table,
    TableColumn,
    number_columns,
)

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
        campaign.words(row): figures.Coverage(
            row["inside_95"], row["inside_95_low"], row["inside_95_high"]
        )
        for row in rows
        if not math.isnan(row.get("inside_95", math.nan))
    }
    drawn = "Coverage by combination, with its 95 % interval; the line is 0.95."
    return [
        Table(columns, cells, caption),
        Picture("coverage", lambda: figures.draw_coverage(named), drawn),
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
