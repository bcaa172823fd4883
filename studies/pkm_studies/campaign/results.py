"""The table of a campaign, and its summary by combination."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oed.base import csv_text
from oed.base.own_files import save_own, write_own
from pkm_studies.campaign import jobs
from pkm_studies.campaign.case import ERROR, PROCESSOR_TIME
from pkm_studies.campaign.machine_summary import summarise_machines
from pkm_studies.campaign.mean_summary import summarise_means
from pkm_studies.campaign.runner import case_paths
from pkm_studies.campaign.tables import Campaign

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
        save = partial(table.to_parquet, index=False)
        written.append(save_own(out / "cases.parquet", save))
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
