"""Predicted accuracy of each component, plan by plan: dots on a log scale, lengths and
angles apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pkm_reports import style, words

Part = Mapping[str, Any]
MOST: Final = 8


def draw(plans: Sequence[Part]) -> Figure:
    """A line for each component, a mark for each plan; left is better."""
    shown = [plan for plan in plans if plan.get("predicted")][:MOST]
    if not shown:
        return style.empty(
            "No predicted accuracy of the plans is stored in this result."
        )
    keys = components(shown)
    kinds = list(dict.fromkeys(words.parted(key)[1] for key in keys))
    groups = [[key for key in keys if words.parted(key)[1] == kind] for kind in kinds]
    labels = [style.safe(str(plan["name"]), 40) for plan in shown]
    columns = style.legend_columns(labels)
    figure = style.figure(
        0.75 + 0.27 * max(map(len, groups)) + 0.17 * -(-len(labels) // columns)
    )
    panels = figure.subplots(1, len(kinds), squeeze=False)[0]
    for axes, kind, group in zip(panels, kinds, groups, strict=True):
        _panel(axes, group, shown, labels)
        axes.set_xlabel(
            f"predicted rms error [{words.unit(kind)}]"
            if kind
            else "predicted rms error"
        )
    handles, texts = panels[0].get_legend_handles_labels()
    figure.legend(handles[::-1], texts[::-1], loc="outside lower center", ncols=columns)
    return figure


def components(plans: Sequence[Part]) -> list[str]:
    """Components that any of the plans tells, in their order."""
    return list(
        dict.fromkeys(key for plan in plans for key in plan.get("predicted") or {})
    )


def _panel(
    axes: Axes, group: Sequence[str], plans: Sequence[Part], labels: Sequence[str]
) -> None:
    rms = np.array(
        [[words.number(plan["predicted"].get(key)) for key in group] for plan in plans]
    )
    rms[~(rms > 0.0)] = np.nan
    at = np.arange(len(group))
    seen = np.isfinite(rms).any(axis=0)
    axes.hlines(
        at[seen],
        np.nanmin(rms[:, seen], axis=0),
        np.nanmax(rms[:, seen], axis=0),
        color=style.LIGHT,
        lw=1.0,
    )
    # the first plan last: it is the chosen one, and lies on top
    for k in reversed(range(len(plans))):
        look: Any = {
            "color": style.CYCLE[k % len(style.CYCLE)],
            "marker": style.marker(k),
            "zorder": 4.0 - 0.1 * k,
        }
        axes.plot(
            rms[k],
            at,
            ls="",
            ms=6 if k == 0 else 5,
            mec="white",
            mew=0.4,
            label=labels[k],
            **look,
        )
    if np.isfinite(rms).any():
        axes.set_xlim(float(np.nanmin(rms)) / 1.35, 1.35 * float(np.nanmax(rms)))
    style.log_axis(axes, "x")
    style.fixed_ticks(axes, "y", at.tolist(), [words.parted(key)[0] for key in group])
    axes.set_ylim(len(group) - 0.5, -0.5)
