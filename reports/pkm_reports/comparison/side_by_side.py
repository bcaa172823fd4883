"""Predicted accuracy of several results as bars side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pkm_reports import style, text

#: share of the distance between two components that their bars take
BROAD = 0.8
Sizes = Mapping[str, tuple[float, str]]


def draw(sizes: Mapping[str, Sizes], names: Sequence[str]) -> Figure:
    """A group of bars for each component; lengths and angles have panels of their own."""
    units = list(dict.fromkeys(u for of in sizes.values() for _, u in of.values()))
    if not units:
        return style.empty("No predicted accuracy is stored in these results.")
    groups = [
        {name: of for name, of in sizes.items() if unit in {u for _, u in of.values()}}
        for unit in units
    ]
    figure = style.figure(2.8)
    widths = [len(group) for group in groups]
    grid = figure.subplots(1, len(units), squeeze=False, width_ratios=widths)
    for axes, unit, group in zip(grid[0], units, groups, strict=True):
        _panel(axes, group, names)
        axes.set_ylabel(f"rms error [{text.unit_symbol(unit)}]")
    style.legend_below(figure, style.legend_entries(grid[0]))
    return figure


def _panel(axes: Axes, group: Mapping[str, Sizes], names: Sequence[str]) -> None:
    places = np.arange(len(group))
    width = BROAD / len(names)
    for k, name in enumerate(names):
        heights = np.array(
            [of[name][0] if name in of else np.nan for of in group.values()]
        )
        shift = width * (k - (len(names) - 1) / 2.0)
        shown = np.where(heights > 0.0, heights, np.nan)
        colour = style.CYCLE[k % len(style.CYCLE)]
        label = style.label(name, 24)
        axes.bar(places + shift, shown, 0.92 * width, color=colour, label=label)
    style.log_axis(axes, "y")
    style.fixed_ticks(axes, "x", places.tolist(), list(group))
