"""Residuals of all readings, before and after the fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pkm_reports import style, words


def draw(estimate: Mapping[str, Any]) -> Figure:
    """Two panels over the number of the reading, in a row for each unit; each has its
    own scale, told by the axis.
    """
    panels = [
        (
            "Nominal machine",
            style.array(estimate.get("residuals_before") or []),
            style.GREY,
        ),
        (
            "Identified machine",
            style.array(estimate.get("residuals") or []),
            style.BLUE,
        ),
    ]
    panels = [panel for panel in panels if np.isfinite(panel[1]).any()]
    if not panels:
        return style.empty("No residuals are stored in this result.")

    channels = estimate["channels"]
    unit = np.array([estimate["units"][c] for c in channels])
    rows = list(dict.fromkeys(unit))
    figure = style.figure(2.4 * len(rows))
    for row, name in zip(
        figure.subplots(len(rows), len(panels), squeeze=False), rows, strict=True
    ):
        for axes, (title, values, colour) in zip(row, panels, strict=True):
            _panel(axes, title, values[unit == name], colour)
            axes.set(
                xlabel="reading, in the order of the data",
                ylabel=f"residual [{words.unit(str(name))}]",
            )
    return figure


def _panel(axes: Axes, title: str, values: Any, colour: str) -> None:
    at = np.arange(1, len(values) + 1)
    axes.vlines(at, 0.0, values, color=colour, lw=0.7, alpha=0.6)
    axes.plot(at, values, "o", ms=2.6 if len(at) > 60 else 3.6, color=colour)
    axes.axhline(0.0, color=style.INK, lw=0.7)
    axes.set_title(f"{title}: rms {words.num(np.sqrt(np.nanmean(values**2)))}")
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    axes.set_ylim(-1.15 * largest, 1.15 * largest)
