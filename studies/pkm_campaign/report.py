"""The report of a campaign: what its cases show, by combination."""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

import oed
from oed import csv_text
from oed.safe_files import write_own
from pkm_campaign import jobs
from pkm_campaign.case import COLUMNS, ERROR, PROCESSOR_TIME, mean_interval
from pkm_campaign.runner import case_paths
from pkm_campaign.tables import Campaign
from pkm_reports import style, text
from pkm_reports.blocks import Block, Code, Items, Picture, Section, Table, TableColumn
from pkm_reports.page import Content, Document

if TYPE_CHECKING:
    import pandas as pd


# Figures of campaigns: coverage by combination.

NOMINAL_COVERAGE = 0.95  #: what 95 % intervals should hold
ROW = 0.28  #: height of a row, inches
AXIS = 0.8  #: height of the axis below the rows, inches
NAME_LENGTH = 40  #: characters of the name beside a row


def draw_coverage(rows: Mapping[str, Mapping[str, float]]) -> Figure:
    """Share of intervals that hold the truth, with its interval, by combination."""
    if not rows:
        return style.empty("no machine could be fitted")
    drawn = style.figure(AXIS + ROW * len(rows))
    axes = drawn.subplots()
    for k, row in enumerate(rows.values()):
        ends = [row["inside_95_low"], row["inside_95_high"]]
        if not math.isnan(ends[0]):
            axes.plot(ends, [k, k], color="C0", linewidth=1.5)
        axes.plot(row["inside_95"], k, "o", color="C0", markersize=4)
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
    count, failed = _counts(rows)
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
        campaign.words(row): row
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
    count, _ = _counts(rows)
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
        count, failed = _counts(rows)
        return [f"{count} cases in {len(rows)} combinations; {failed} failed."]
    return machine_sentences(campaign, rows)


def _counts(rows: Rows) -> tuple[int, int]:
    """How many cases there are, and how many of them failed."""
    return sum(int(r["cases"]) for r in rows), sum(int(r["failed"]) for r in rows)


def _rows(summary: pd.DataFrame) -> Rows:
    return [{str(k): v for k, v in row.items()} for row in summary.to_dict("records")]


# The table of a campaign, and its summary by combination.
def read_table(campaign: Campaign, out: Path) -> pd.DataFrame:
    """One row a case, in the campaign's order, without processor times: always the same."""
    import pandas as pd

    rows = [jobs.read_row(path) for path in case_paths(campaign, out)]
    cells = [
        {k: _cell(v) for k, v in row.items() if k != PROCESSOR_TIME} for row in rows
    ]
    return pd.DataFrame(cells)


def processor_time(campaign: Campaign, out: Path) -> float:
    """Processor time of all cases, s, wherever they ran."""
    rows = (jobs.read_row(path) for path in case_paths(campaign, out))
    return float(sum(row.get(PROCESSOR_TIME, 0.0) for row in rows))


def write_table(
    table: pd.DataFrame, summary: pd.DataFrame, out: Path
) -> tuple[Path, ...]:
    """Write `cases.csv` and `summary.csv`, whole; their paths.

    With the extra `parquet`, `cases.parquet` too. One that the user changed stays, and
    the new one gets a number.
    """
    written = []
    if importlib.util.find_spec("pyarrow") is not None:
        content = table.to_parquet(index=False)
        written.append(write_own(out / "cases.parquet", content))
    return (
        *written,
        write_own(out / "cases.csv", csv_text.of_frame(table).encode()),
        write_own(out / "summary.csv", csv_text.of_frame(summary).encode()),
    )


def summarise(campaign: Campaign, table: pd.DataFrame) -> pd.DataFrame:
    """One row a combination: its setting, cases, failures, and figures of the others.

    The figures are those of virtual machines, or those of the campaign's own `summary`,
    or means with intervals.
    """
    import pandas as pd

    figures = _summary_function(campaign)
    rows = []
    for setting in campaign.settings():
        cells = {k: _cell(v) for k, v in setting.items()}
        chosen = np.ones(len(table), dtype=bool)
        for field, value in cells.items():
            chosen &= (table[field] == value).to_numpy()
        cases = table[chosen]
        fitted = cases[cases[ERROR] == ""].infer_objects()
        row = {**cells, "cases": len(cases), "failed": len(cases) - len(fitted)}
        if len(fitted):
            row |= figures(fitted, cells)
        rows.append(row)
    return pd.DataFrame(rows)


def _summary_function(
    campaign: Campaign,
) -> Callable[[pd.DataFrame, dict[str, Any]], Mapping[str, Any]]:
    """What summarises the cases of a combination that have no error."""
    if campaign.varied is not None:
        return lambda fitted, setting: summarise_machines(fitted)
    if campaign.summary:
        return campaign.user_function(campaign.summary).load("summary")
    return summarise_means


def _cell(value: Any) -> Any:
    """A value that a table can hold: lists and tables as JSON."""
    return json.dumps(value) if isinstance(value, list | dict) else value


# -- summary of a case function --------------------------------------------------------
def summarise_means(cases: pd.DataFrame, setting: dict[str, Any]) -> dict[str, Any]:
    """Mean of each column of numbers, and the ends of its interval over cases."""
    row: dict[str, Any] = {}
    for column in cases.select_dtypes(["number", "bool"]).columns:
        if column in setting or column in COLUMNS:
            continue
        values = cases[column].dropna().to_numpy(dtype=float)
        if not len(values):
            continue
        low, high = mean_interval(values)
        row |= {column: float(values.mean())}
        row |= {f"{column}_low": low, f"{column}_high": high}
    return row


# -- summary of virtual machines -------------------------------------------------------
def summarise_machines(fitted: pd.DataFrame) -> dict[str, Any]:
    """Figures of the machines of a combination that could be fitted.

    inside_95  share of intervals of identifiable combinations that hold the truth, with
               the 95 % interval of its mean over machines
    not_trusted  share of machines whose fit is not to be trusted
    nees       mean squared error over the predicted covariance, a combination
    predicted, realised   rms over machines, by component
    """
    inside = fitted["inside_95"].to_numpy()
    low, high = mean_interval(inside)
    row: dict[str, Any] = {
        "inside_95": float(inside.mean()),
        "inside_95_low": float(np.maximum(0.0, low)),
        "inside_95_high": float(np.minimum(1.0, high)),
        "nees": float(fitted["nees"].mean()),
    }
    if "trusted" in fitted:
        row["not_trusted"] = 1.0 - float(fitted["trusted"].mean())
    for column in fitted.columns:
        if column.startswith(("predicted_", "realised_")):
            row[column] = float(np.sqrt(np.mean(fitted[column] ** 2)))
    if "verdict" in fitted:
        exact = fitted["answer"] == fitted["acting"]
        row["effects_named"] = float(exact.mean())
    return row
