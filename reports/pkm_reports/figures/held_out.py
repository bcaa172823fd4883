"""Readings that the fit did not see, against what it predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pkm_reports import style, words


def draw(sets: Sequence[Mapping[str, Any]]) -> Figure:
    """Measured minus predicted, with the 95 % predictive interval of each reading as a
    bar around zero.
    """
    shown = [entry for entry in sets if len(entry.get("residuals") or [])]
    if not shown:
        return style.empty("No held-out residuals are stored in this result.")
    figure = style.figure(0.5 + 1.75 * len(shown))
    for axes, entry in zip(
        figure.subplots(len(shown), 1, squeeze=False)[:, 0], shown, strict=True
    ):
        _panel(axes, entry)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _panel(axes: Axes, entry: Mapping[str, Any]) -> None:
    residuals = style.array(entry["residuals"])
    half = np.resize(style.array(entry.get("half_widths") or [np.nan]), len(residuals))
    at = np.arange(1, len(residuals) + 1)
    inside = ~(np.abs(residuals) > half)
    axes.vlines(
        at,
        -half,
        half,
        color=style.LIGHT,
        lw=min(7.0, 200.0 / len(at)),
        label="95 % predictive interval",
    )
    axes.plot(at[inside], residuals[inside], "o", color=style.BLUE, label="inside")
    axes.plot(
        at[~inside], residuals[~inside], "X", color=style.RED, ms=5, label="outside"
    )
    axes.axhline(0.0, color=style.INK, lw=0.7)
    axes.xaxis.set_major_locator(MaxNLocator(12, integer=True))
    axes.set_title(style.safe(f"{entry['name']}: {entry['channel']}", 70))
    axes.set(xlabel="reading", ylabel=f"residual [{words.unit(str(entry['unit']))}]")
