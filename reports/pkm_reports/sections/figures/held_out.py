"""Residuals of held-out readings, with their predictive intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.result import HeldOutSection
from pkm_reports import missing, style, text


def draw(sets: Sequence[HeldOutSection]) -> Figure:
    """Measured minus predicted, each with its 95 % interval as a bar around zero."""
    shown = [entry for entry in sets if entry.residuals]
    if not shown:
        return style.empty("No held-out residuals are stored in this result.")
    figure = style.figure(0.5 + 1.75 * len(shown))
    panels = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
    for axes, entry in zip(panels, shown, strict=True):
        _panel(axes, entry)
    style.legend_below(figure, style.legend_entries(figure.axes[:1]), 3)
    return figure


def _panel(axes: Axes, entry: HeldOutSection) -> None:
    residuals = missing.array(entry.residuals)
    half = np.resize(missing.array(entry.half_widths or [None]), len(residuals))
    number = np.arange(1, len(residuals) + 1)
    inside = ~(np.abs(residuals) > half)
    bars: Any = {"color": style.LIGHT, "lw": min(7.0, 200.0 / len(number))}
    axes.vlines(number, -half, half, label="95 % predictive interval", **bars)
    axes.plot(
        number[inside],
        residuals[inside],
        "o",
        color=style.BLUE,
        label="inside",
    )
    cross: Any = {"color": style.RED, "ms": 5, "label": "outside"}
    axes.plot(number[~inside], residuals[~inside], "X", **cross)
    axes.axhline(0.0, color=style.INK, lw=0.7)
    axes.xaxis.set_major_locator(MaxNLocator(12, integer=True))
    axes.set_title(style.label(f"{entry.name}: {entry.channel}", 70))
    unit = text.unit_symbol(entry.unit)
    axes.set(xlabel="reading", ylabel=f"residual [{unit}]")
