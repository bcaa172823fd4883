"""Accuracy over the number of readings, with the bound for each number."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import HowManySummary
from pkm_reports import missing, style, text

MOST_COLUMNS: Final = 3
MOST_TICKS: Final = 5


def draw(summary: HowManySummary) -> Figure:
    """A panel for each component: plans found, the bound below, the wanted accuracy."""
    sizes = missing.array(summary.sizes)
    names = [
        name
        for name, values in summary.accuracy.items()
        if len(values) == len(sizes) and missing.finite(values)
    ]
    if not names:
        return style.empty(
            "No accuracy over the number of readings is stored in this result."
        )
    columns = 2 if len(names) == 4 else min(MOST_COLUMNS, len(names))
    rows = math.ceil(len(names) / columns)
    figure = style.figure(0.65 + (2.6 if columns == 1 else 2.05) * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, (axes, name) in enumerate(zip(grid, names, strict=False)):
        _panel(axes, name, sizes, summary)
        if k + columns >= len(names):
            axes.set_xlabel("number of readings")
    style.hide(grid[len(names) :])
    style.legend_below(figure, style.legend_entries(grid))
    return figure


def _panel(
    axes: Axes,
    name: str,
    sizes: Array,
    summary: HowManySummary,
) -> None:
    reached = missing.array(summary.accuracy[name])
    bound = _bound(summary.bound, name, len(sizes))
    wanted = missing.entry(summary.wanted, name)
    values = np.concatenate([reached, bound, [wanted]])
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = float(values.min()) / 1.3, 1.3 * float(values.max())
    if np.isfinite(bound).any():
        label = "no plan of as many readings is better"
        axes.fill_between(
            sizes,
            low,
            bound,
            color=style.LIGHT,
            lw=0,
            label=label,
        )
        axes.plot(sizes, bound, color=style.GREY, lw=0.8)
    axes.plot(sizes, reached, "o-", color=style.BLUE, label="plans found")
    if np.isfinite(wanted):
        axes.axhline(
            wanted,
            color=style.RED,
            ls="--",
            lw=1.0,
            label="wanted",
        )
    if summary.fewest is not None:
        label = f"fewest that reach all wanted: {summary.fewest}"
        line: Any = {"color": style.GREEN, "ls": ":", "lw": 1.3}
        axes.axvline(summary.fewest, label=label, **line)
    axes.set_ylim(low, high)
    axes.set_xscale("log")
    axes.set_xlim(float(sizes.min()) / 1.08, 1.08 * float(sizes.max()))
    style.log_axis(axes, "y")
    ticks = _ticks(sizes)
    style.fixed_ticks(axes, "x", ticks, [text.trimmed(n) for n in ticks])
    axes.set_title(style.label(text.heading(name)))


def _bound(
    bounds: Mapping[str, Sequence[float | None]],
    name: str,
    count: int,
) -> Array:
    """The bound at each number of readings, NaN where it is not known."""
    if name not in bounds or len(bounds[name]) != count:
        return np.full(count, np.nan)
    return missing.array(bounds[name])


def _ticks(sizes: Array) -> Sequence[float]:
    """A few of the sizes, evenly apart on a log axis, both ends among them."""
    if len(sizes) <= MOST_TICKS:
        return [float(n) for n in sizes]
    places = np.geomspace(sizes[0], sizes[-1], MOST_TICKS)
    nearest = [int(np.argmin(np.abs(np.log(sizes / size)))) for size in places]
    return sorted({float(sizes[k]) for k in nearest})
