"""The robust and the nominal plan over the scenarios, as cumulative distributions."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import RobustSummary
from pkm_reports import missing, style, text

#: factor between the limits from which the axis is logarithmic
WIDE = 8.0


def draw(robust: RobustSummary) -> Figure:
    """Share of the scenarios in which a plan is worth no more than so much."""
    values = missing.array(robust.values)
    nominal = missing.array(robust.nominal_values)
    finite = [v for v in (values, nominal) if np.isfinite(v).any()]
    if not finite:
        return style.empty("No values of the scenarios are stored in this result.")
    best = max(float(np.nanmax(v)) for v in finite)
    figure = style.figure(2.7)
    axes = figure.subplots()
    if robust.risk == "cvar" and 0.0 < robust.level < 1.0:
        label = f"the worst {text.percent(robust.level)}: their mean counts"
        shade: Any = {
            "color": style.SHADE,
            "lw": 0,
            "zorder": 0,
            "label": label,
        }
        axes.axhspan(0.0, 100.0 * robust.level, **shade)
    _distribution(axes, nominal, robust.nominal, best, "nominal plan", 1)
    _distribution(axes, values, robust.value, best, "robust plan", 0)
    axes.set_xlabel("worth in a scenario [% of the best one of all]")
    axes.set_ylabel("share of the scenarios [%]")
    axes.set_ylim(0.0, 104.0)
    low, high = axes.get_xlim()
    if low > 0.0 and high > WIDE * low:
        style.log_axis(axes, "x")
    style.legend_below(figure, style.legend_entries([axes]))
    return figure


def _distribution(
    axes: Axes, values: Array, by_risk: float, best: float, label: str, k: int
) -> None:
    """The scenarios of a plan, worst first; a dashed line at its worth by the risk."""
    values = np.sort(values[np.isfinite(values)])
    if not len(values):
        return
    colour = style.CYCLE[k]
    worth = 100.0 * np.exp(values - best)
    share = 100.0 * np.arange(1, len(values) + 1) / len(values)
    look: Any = {
        "marker": style.marker(k),
        "ms": 3.5,
        "drawstyle": "steps-post",
    }
    axes.plot(worth, share, color=colour, label=f"{label}, each scenario", **look)
    dashed: Any = {"color": colour, "ls": "--", "lw": 1.0}
    if np.isfinite(by_risk):
        worth_by_risk = 100.0 * float(np.exp(by_risk - best))
        axes.axvline(worth_by_risk, label=f"{label}, by the risk", **dashed)
