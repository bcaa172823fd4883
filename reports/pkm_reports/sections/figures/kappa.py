"""Condition number over the number of circles and of points on each circle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.base import Array
from oed.result import KappaMap
from pkm_reports import missing, style, text

#: kappa above so many times the smallest leaves the panel, so that the minimum shows
CUT: Final = 30.0


def draw(maps: Sequence[KappaMap]) -> Figure:
    """A panel for each parametrisation, a line over n for each number of circles m.

    A ring marks the smallest of each line.
    """
    shown = [entry for entry in maps if np.isfinite(missing.table(entry.kappa)).any()]
    if not shown:
        return style.empty("No finite condition number is stored in this result.")
    columns = min(2, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = style.figure(0.3 + 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, entry in zip(grid, shown, strict=False):
        _panel(axes, entry)
    style.hide(grid[len(shown) :])
    return figure


def _panel(axes: Axes, entry: KappaMap) -> None:
    n = missing.array(entry.points)
    table = missing.table(entry.kappa)
    for k, (m, kappa) in enumerate(zip(entry.circles, table, strict=True)):
        colour = style.CYCLE[k % len(style.CYCLE)]
        label = f"m = {m}: {_smallest(n, kappa)}"
        axes.plot(
            n,
            kappa,
            marker=style.marker(k),
            ms=3,
            color=colour,
            label=label,
        )
        if np.isfinite(kappa).any():
            smallest = int(np.nanargmin(kappa))
            ring: Any = {
                "ms": 9,
                "mfc": "none",
                "mec": colour,
                "mew": 1.2,
            }
            axes.plot(n[smallest], kappa[smallest], "o", **ring)
    low, high = float(np.nanmin(table)), float(np.nanmax(table))
    axes.set_ylim(0.8 * low, min(CUT * low, 1.25 * high))
    style.log_axis(axes, "y")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    axes.set(xlabel="points on each circle, n", ylabel="condition number κ")
    axes.set_title(style.label(entry.title, 44))
    legend: Any = {"loc": "upper center", "bbox_to_anchor": (0.48, -0.2)}
    axes.legend(ncols=2, handlelength=1.6, columnspacing=1.2, **legend)


def _smallest(n: Array, kappa: Array) -> str:
    """Smallest value of a line and where it is."""
    if not np.isfinite(kappa).any():
        return "not finite"
    smallest = int(np.nanargmin(kappa))
    return f"{text.number(kappa[smallest], 4)} at n = {n[smallest]:.0f}"
