"""Summary of a case function's figures: means with their 95 % intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pkm_studies.campaign.case import COLUMNS
from pkm_studies.campaign.interval import mean_interval

if TYPE_CHECKING:
    import pandas as pd


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
