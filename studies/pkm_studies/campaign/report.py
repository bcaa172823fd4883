"""The report of a campaign: coverage and accuracy by combination, with figures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import oed
from pkm_reports import document, text
from pkm_reports.blocks import (
    Block,
    Code,
    Items,
    Picture,
    Section,
    Table,
    TableColumn,
    number_columns,
)
from pkm_reports.document import Content
from pkm_reports.figures import campaign as figures
from pkm_reports.report import write_document
from pkm_studies.campaign.tables import Campaign

if TYPE_CHECKING:
    import pandas as pd


def write_report(
    campaign: Campaign, summary: pd.DataFrame, out: Path
) -> tuple[Path, ...]:
    """Write `report.html` and `report.pdf` of a campaign's summary; their paths."""
    rows = [{str(k): v for k, v in row.items()} for row in summary.to_dict("records")]
    study = campaign.varied
    content = Content(
        title=campaign.title or f"Campaign {campaign.name}",
        question=f"What do {_machines(rows)} virtual machines of {study.name} show?",
        study=campaign.name,
        machine=study.machine.model,
        foot=f"{campaign.name} · pkm-oed {oed.__version__}",
        answer=[
            Section(
                "found", "What the machines show", [Items(sentences(campaign, summary))]
            )
        ],
        chapters=[
            Section("intervals", "Intervals", _intervals(campaign, rows)),
            Section(
                "accuracy", "Accuracy after compensation", _accuracy(campaign, rows)
            ),
        ],
        appendix=[Section("file", "Campaign file", [Code(campaign.text)])],
    )
    return write_document(document.assembled(content), out, "report")


def sentences(campaign: Campaign, summary: pd.DataFrame) -> list[str]:
    """What a summary says, the most important first."""
    rows = [{str(k): v for k, v in row.items()} for row in summary.to_dict("records")]
    failed = sum(int(row["failed"]) for row in rows)
    lines = [
        f"{_machines(rows)} virtual machines in {len(rows)} combinations; {failed} could"
        " not be fitted."
    ]
    fitted = [row for row in rows if not math.isnan(row.get("inside_95", math.nan))]
    if not fitted:
        return lines
    least = min(fitted, key=lambda row: row["inside_95"])
    most = max(fitted, key=lambda row: row["inside_95"])
    lines.append(
        "95 % intervals of identifiable combinations hold the truth in"
        f" {least['inside_95']:.3f} ({_name(campaign, least)}) to"
        f" {most['inside_95']:.3f} ({_name(campaign, most)}) of the cases."
    )
    ratios = [ratio for row in fitted for ratio in _ratios(row).values()]
    if ratios:
        lines.append(
            f"Realised over predicted rms error: {min(ratios):.2f} to {max(ratios):.2f}."
        )
    return lines


def _machines(rows: list[dict[str, Any]]) -> int:
    return sum(int(row["machines"]) for row in rows)


def _name(campaign: Campaign, row: dict[str, Any]) -> str:
    """A combination in words; the study itself where nothing varies.

    Fields go by the last part of their address, where it is theirs alone.
    """
    short = [field.rpartition(".")[2] for field in campaign.vary]
    unique = len(set(short)) == len(short)
    names = short if unique else list(campaign.vary)
    pairs = zip(names, campaign.vary, strict=True)
    parts = [f"{name} = {row[field]}" for name, field in pairs]
    return ", ".join(parts) or "the study as it is"


def _ratios(row: dict[str, Any]) -> dict[str, float]:
    """Realised over predicted rms error, by component with its unit."""
    ratios = {}
    for column, predicted in row.items():
        if not column.startswith("predicted_") or not predicted > 0.0:
            continue
        name = column.removeprefix("predicted_")
        ratios[name] = row[f"realised_{name}"] / predicted
    return ratios


def _intervals(campaign: Campaign, rows: list[dict[str, Any]]) -> list[Block]:
    columns = [
        TableColumn("Combination"),
        *number_columns(
            "machines", "not fitted", "inside 95 %", "its interval", "NEES", "p < 0.001"
        ),
    ]
    cells = [
        [
            _name(campaign, row),
            str(row["machines"]),
            str(row["failed"]),
            _figure(row, "inside_95"),
            f"{_figure(row, 'inside_95_low')} to {_figure(row, 'inside_95_high')}",
            _figure(row, "nees"),
            _figure(row, "misfit_alarms"),
        ]
        for row in rows
    ]
    caption = (
        "Share of 95 % intervals of identifiable combinations that hold the truth; mean"
        " squared error over its predicted covariance (NEES, 1 where it is right); share"
        " of machines whose fit has p < 0.001 against the stated noise."
    )
    named = {
        _name(campaign, row): figures.Coverage(
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


def _accuracy(campaign: Campaign, rows: list[dict[str, Any]]) -> list[Block]:
    names = list(dict.fromkeys(n for row in rows for n in _ratios(row)))
    columns = [TableColumn("Combination")]
    for name in names:
        component, _, unit = name.rpartition("_")
        symbol = text.unit_symbol(unit)
        columns += number_columns(f"{component} [{symbol}]", "over predicted")
    cells = []
    for row in rows:
        line = [_name(campaign, row)]
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
