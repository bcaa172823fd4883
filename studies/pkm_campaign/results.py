"""The table of a campaign, and its summary by combination."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oed import csv_text
from oed.safe_files import write_own
from pkm_campaign import jobs
from pkm_campaign.case import COLUMNS, ERROR, PROCESSOR_TIME, mean_interval
from pkm_campaign.runner import case_paths
from pkm_campaign.tables import Campaign

if TYPE_CHECKING:
    import pandas as pd


def read_table(campaign: Campaign, out: Path) -> pd.DataFrame:
    """One row a case, in the order of the campaign, however it was run.

    Without processor times, so that the same campaign gives the same table.
    """
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
