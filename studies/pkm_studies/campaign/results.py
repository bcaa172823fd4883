"""The table of a campaign, and its summary by combination."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oed.whole_file import whole_file
from pkm_studies.campaign.machine_case import HALF_WIDTH
from pkm_studies.campaign.runner import case_paths
from pkm_studies.campaign.tables import Campaign

if TYPE_CHECKING:
    import pandas as pd


def read_table(campaign: Campaign, out: Path) -> pd.DataFrame:
    """One row a case, in the order of the campaign, however it was run."""
    import pandas as pd

    paths = case_paths(campaign, out)
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
    return pd.DataFrame([{k: _cell(v) for k, v in row.items()} for row in rows])


def write_table(table: pd.DataFrame, out: Path) -> tuple[Path, Path]:
    """Write `cases.parquet` and `cases.csv`, whole."""
    parquet, csv = out / "cases.parquet", out / "cases.csv"
    with whole_file(parquet) as part:
        table.to_parquet(part, index=False)
    with whole_file(csv) as part:
        table.to_csv(part, index=False, lineterminator="\n")
    return parquet, csv


def summarise(campaign: Campaign, table: pd.DataFrame) -> pd.DataFrame:
    """One row a combination: failures, coverage, and predicted over realised accuracy.

    inside_95  share of intervals of identifiable combinations that hold the truth, with
               the 95 % interval of its mean over machines
    nees       mean squared error over the predicted covariance, a combination
    predicted, realised   rms over machines, by component
    """
    import pandas as pd

    rows = []
    for setting in campaign.settings():
        cells = {k: _cell(v) for k, v in setting.items()}
        chosen = np.ones(len(table), dtype=bool)
        for field, value in cells.items():
            chosen &= (table[field] == value).to_numpy()
        rows.append({**cells, **_summary(table[chosen])})
    return pd.DataFrame(rows)


def _summary(cases: pd.DataFrame) -> dict[str, Any]:
    fitted = cases[cases["error"] == ""]
    row: dict[str, Any] = {
        "machines": len(cases),
        "failed": len(cases) - len(fitted),
    }
    if fitted.empty:
        return row
    low, high = _mean_interval(fitted["inside_95"].to_numpy())
    row |= {
        "inside_95": float(fitted["inside_95"].mean()),
        "inside_95_low": low,
        "inside_95_high": high,
        "nees": float(fitted["nees"].mean()),
        "misfit_alarms": float((fitted["p_value"] < 0.001).mean()),
    }
    for column in fitted.columns:
        if column.startswith(("predicted_", "realised_")):
            row[column] = float(np.sqrt(np.mean(fitted[column] ** 2)))
    if "verdict" in fitted:
        exact = fitted["answer"] == fitted["acting"]
        row["effects_named"] = float(exact.mean())
    return row


def _mean_interval(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """95 % interval of a mean over machines; no interval from one machine."""
    n = len(values)
    if n < 2:
        return math.nan, math.nan
    mean, half = np.mean(values), HALF_WIDTH * np.std(values, ddof=1) / np.sqrt(n)
    return float(max(0.0, mean - half)), float(min(1.0, mean + half))


def _cell(value: Any) -> Any:
    """A value that a table can hold: lists and tables as JSON."""
    return json.dumps(value) if isinstance(value, list | dict) else value
