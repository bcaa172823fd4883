"""Condition number over the number of circles and of points on each, one panel for each
parametrisation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pkm_reports import style, words

#: kappa so much above the smallest leaves the picture at the top, so that the minimum
#: keeps its shape
CUT: Final = 30.0


def draw(maps: Sequence[Mapping[str, Any]]) -> Figure:
    """Lines over n, one for each number of circles m; a ring marks the smallest of each
    line.
    """
    shown = [m for m in maps if np.isfinite(style.array(m.get("kappa") or [[]])).any()]
    if not shown:
        return style.empty("No finite condition number is stored in this result.")
    columns = min(2, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = style.figure(0.3 + 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, entry in zip(grid, shown, strict=False):
        _panel(axes, entry)
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    return figure


def _panel(axes: Axes, entry: Mapping[str, Any]) -> None:
    n = style.array(entry["points"])
    table = style.array(entry["kappa"]).reshape(len(entry["circles"]), len(n))
    top = CUT * float(np.nanmin(table))
    for k, (m, kappa) in enumerate(zip(entry["circles"], table, strict=True)):
        colour = style.CYCLE[k % len(style.CYCLE)]
        label = f"m = {m}: {_smallest(n, kappa)}"
        axes.plot(n, kappa, marker=style.marker(k), ms=3, color=colour, label=label)
        if np.isfinite(kappa).any():
            at = int(np.nanargmin(kappa))
            axes.plot(n[at], kappa[at], "o", ms=9, mfc="none", mec=colour, mew=1.2)
    axes.set_ylim(
        0.8 * float(np.nanmin(table)), min(top, 1.25 * float(np.nanmax(table)))
    )
    style.log_axis(axes, "y")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    axes.set(xlabel="points on each circle, n", ylabel="condition number κ")
    axes.set_title(style.safe(entry["title"], 44))
    axes.legend(
        ncols=2,
        loc="upper center",
        bbox_to_anchor=(0.48, -0.2),
        handlelength=1.6,
        columnspacing=1.2,
    )


def _smallest(n: Any, kappa: Any) -> str:
    """Smallest value of a line and where it is."""
    if not np.isfinite(kappa).any():
        return "not finite"
    at = int(np.nanargmin(kappa))
    return f"{words.num(kappa[at], 4)} at n = {n[at]:.0f}"
