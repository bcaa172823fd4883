"""Accuracy over the number of readings, with what no plan of as many readings can
better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.arrays import Array
from pkm_reports import style, words

Part = Mapping[str, Any]
MOST_COLUMNS: Final = 3
MOST_TICKS: Final = 5


def draw(part: Part) -> Figure:
    """A panel for each component: plans found, the shaded limit below them, the wanted
    accuracy as a line.
    """
    sizes, told = style.array(part.get("sizes") or []), part.get("accuracy") or {}
    names = [
        n
        for n, v in told.items()
        if len(v) == len(sizes) and np.isfinite(style.array(v)).any()
    ]
    if not names:
        return style.empty(
            "No accuracy over the number of readings is stored in this result."
        )
    columns = min(MOST_COLUMNS, len(names)) if len(names) != 4 else 2
    rows = math.ceil(len(names) / columns)
    figure = style.figure(0.65 + (2.6 if columns == 1 else 2.05) * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, (axes, name) in enumerate(zip(grid, names, strict=False)):
        _panel(axes, name, sizes, part)
        if k + columns >= len(names):
            axes.set_xlabel("number of readings")
    for axes in grid[len(names) :]:
        axes.set_visible(False)
    named = {
        label: handle
        for axes in grid
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        named.values(),
        named.keys(),
        loc="outside lower center",
        ncols=style.legend_columns(list(named)),
    )
    return figure


def _panel(axes: Axes, name: str, sizes: Array, part: Part) -> None:
    reached = style.array(part["accuracy"][name])
    bound = style.array((part.get("bound") or {}).get(name) or [])
    bound = bound if len(bound) == len(sizes) else np.full(len(sizes), np.nan)
    wanted = words.number((part.get("wanted") or {}).get(name))
    values = np.concatenate([reached, bound, [wanted]])
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = float(values.min()) / 1.3, 1.3 * float(values.max())
    if np.isfinite(bound).any():
        axes.fill_between(
            sizes,
            low,
            bound,
            color=style.LIGHT,
            lw=0,
            label="no plan of as many readings is better",
        )
        axes.plot(sizes, bound, color=style.GREY, lw=0.8)
    axes.plot(sizes, reached, "o-", color=style.BLUE, label="plans found")
    if np.isfinite(wanted):
        axes.axhline(wanted, color=style.RED, ls="--", lw=1.0, label="wanted")
    fewest = words.number(part.get("fewest"))
    if np.isfinite(fewest):
        axes.axvline(
            fewest,
            color=style.GREEN,
            ls=":",
            lw=1.3,
            label=f"fewest that reach all wanted: {fewest:.0f}",
        )
    axes.set_ylim(low, high)
    axes.set_xscale("log")
    axes.set_xlim(float(sizes.min()) / 1.08, 1.08 * float(sizes.max()))
    style.log_axis(axes, "y")
    picked = _some(sizes)
    style.fixed_ticks(axes, "x", picked, [words.plain(n) for n in picked])
    axes.set_title(style.safe(words.heading(name)))


def _some(sizes: Array) -> Sequence[float]:
    """At most so many of the sizes, evenly apart on a log axis, the ends among them."""
    if len(sizes) <= MOST_TICKS:
        return [float(n) for n in sizes]
    places = np.geomspace(sizes[0], sizes[-1], MOST_TICKS)
    return sorted(
        {float(sizes[int(np.argmin(np.abs(np.log(sizes / p))))]) for p in places}
    )
