"""Residuals of all readings, before and after the fit."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.base import Array
from oed.result import EstimateSection
from pkm_reports import missing, style, text

#: readings from which marks are small
MANY: Final = 60


def draw(estimate: EstimateSection) -> Figure:
    """Before and after side by side, a row for each unit, each panel with its scale."""
    before, after = estimate.residuals_before, estimate.residuals
    panels = [
        ("Nominal machine", missing.array(before), style.GREY),
        ("Identified machine", missing.array(after), style.BLUE),
    ]
    panels = [panel for panel in panels if np.isfinite(panel[1]).any()]
    if not panels:
        return style.empty("No residuals are stored in this result.")
    unit_of_each = np.array([estimate.units[name] for name in estimate.channels])
    units = list(dict.fromkeys(unit_of_each.tolist()))
    figure = style.figure(2.4 * len(units))
    grid = figure.subplots(len(units), len(panels), squeeze=False)
    for row, unit in zip(grid, units, strict=True):
        label = f"residual [{text.unit_symbol(unit)}]"
        for axes, (title, values, colour) in zip(row, panels, strict=True):
            _panel(axes, title, values[unit_of_each == unit], colour)
            axes.set(xlabel="reading, in the order of the data", ylabel=label)
    return figure


def _panel(
    axes: Axes,
    title: str,
    values: Array,
    colour: str,
) -> None:
    number = np.arange(1, len(values) + 1)
    axes.vlines(
        number,
        0.0,
        values,
        color=colour,
        lw=0.7,
        alpha=0.6,
    )
    axes.plot(
        number,
        values,
        "o",
        ms=2.6 if len(number) > MANY else 3.6,
        color=colour,
    )
    axes.axhline(0.0, color=style.INK, lw=0.7)
    rms = np.sqrt(np.nanmean(values**2))
    axes.set_title(f"{title}: rms {text.number(rms)}")
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    axes.set_ylim(-1.15 * largest, 1.15 * largest)
