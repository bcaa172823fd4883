"""Summary of virtual machines: coverage, and realised over predicted accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pkm_studies.campaign.interval import mean_interval

if TYPE_CHECKING:
    import pandas as pd


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
