"""Sources of the uncertainty that remains, as shares of each component's variance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import ComponentAccuracy
from pkm_reports import missing, style

#: percent from which a share is written into its bar
WRITTEN: Final = 7.0
#: characters of all names together from which the legend has fewer columns
MANY_CHARACTERS: Final = 60


def draw(components: Mapping[str, ComponentAccuracy]) -> Figure:
    """One stacked bar for each component."""
    budgets = [component.budget for component in components.values()]
    sources = list(dict.fromkeys(name for budget in budgets for name in budget))
    if not sources:
        return style.empty("No uncertainty budget is stored in this result.")
    legend_rows = np.ceil(len(sources) / 4)
    figure = style.figure(0.95 + 0.26 * len(components) + 0.16 * legend_rows)
    axes = figure.subplots()
    start = np.zeros(len(budgets))
    for k, source in enumerate(sources):
        percent = np.nan_to_num(100.0 * missing.column(budgets, source))
        _stack(axes, k, source, start, percent)
        start = start + percent
    style.fixed_ticks(axes, "y", range(len(components)), list(components))
    axes.set_xlim(0.0, max(100.0, start.max()))
    axes.set_xlabel("share of the variance that remains [%]")
    axes.set_ylim(len(components) - 0.5, -0.5)
    axes.grid(False)
    few = sum(map(len, sources)) < MANY_CHARACTERS
    figure.legend(loc="outside lower center", ncols=5 if few else 4)
    return figure


def _stack(
    axes: Axes,
    k: int,
    source: str,
    start: Array,
    percent: Array,
) -> None:
    """The k-th source beside those before it, hatched where the colours repeat."""
    colour = style.CYCLE[k % len(style.CYCLE)]
    look: Any = {
        "height": 0.7,
        "color": colour,
        "hatch": "///" if k >= len(style.CYCLE) else None,
        "ec": "white",
        "label": style.label(source),
    }
    bars = axes.barh(
        range(len(percent)),
        percent,
        left=start,
        **look,
    )
    written = [f"{share:.0f}" if share >= WRITTEN else "" for share in percent]
    letters: Any = {"fontsize": 7, "fontweight": "bold"}
    letters["color"] = style.INK if colour in style.PALE else "white"
    axes.bar_label(bars, written, label_type="center", **letters)
