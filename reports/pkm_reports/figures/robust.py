"""How good the robust plan and the nominal one are in each scenario: distributions side
by side.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.arrays import Array
from pkm_reports import style, words

Part = Mapping[str, Any]


def draw(robust: Part) -> Figure:
    """Share of the scenarios in which a plan is worth no more than so much; right is
    better.
    """
    values, nominal = (
        style.array(robust.get("values") or []),
        style.array(robust.get("nominal_values") or []),
    )
    known = [v for v in (values, nominal) if np.isfinite(v).any()]
    if not known:
        return style.empty("No values of the scenarios are stored in this result.")
    best = max(float(np.nanmax(v)) for v in known)
    figure = style.figure(2.7)
    axes = figure.subplots()
    level = words.number(robust.get("level"))
    if robust.get("risk") == "cvar" and 0.0 < level < 1.0:
        share = words.percent(level)
        axes.axhspan(
            0.0,
            100.0 * level,
            color="#eef1f4",
            lw=0,
            zorder=0,
            label=f"the worst {share}: their mean counts",
        )
    _steps(axes, nominal, robust.get("nominal"), best, "nominal plan", 1)
    _steps(axes, values, robust.get("value"), best, "robust plan", 0)
    axes.set(
        xlabel="worth in a scenario [% of the best one of all]",
        ylabel="share of the scenarios [%]",
    )
    axes.set_ylim(0.0, 104.0)
    low, high = axes.get_xlim()
    if low > 0.0 and high > 8.0 * low:
        style.log_axis(axes, "x")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=style.legend_columns(labels)
    )
    return figure


def _steps(
    axes: Axes, values: Array, by_risk: Any, best: float, label: str, k: int
) -> None:
    """The plan's scenarios, worst first; a dashed line where the plan stands by the
    risk that was asked for.
    """
    values = np.sort(values[np.isfinite(values)])
    if not len(values):
        return
    colour, worth = style.CYCLE[k], 100.0 * np.exp(values - best)
    share = 100.0 * np.arange(1, len(values) + 1) / len(values)
    look: Any = {
        "color": colour,
        "marker": style.marker(k),
        "ms": 3.5,
        "drawstyle": "steps-post",
    }
    axes.plot(worth, share, label=f"{label}, each scenario", **look)
    one = words.number(by_risk)
    if np.isfinite(one):
        axes.axvline(
            100.0 * float(np.exp(one - best)),
            color=colour,
            ls="--",
            lw=1.0,
            label=f"{label}, by the risk",
        )
