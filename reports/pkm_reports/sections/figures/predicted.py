"""Predicted accuracy of each component, plan by plan, as marks on a log scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.result import PlanScore
from pkm_reports import missing, style, text

MOST: Final = 8


def draw(plans: Sequence[PlanScore]) -> Figure:
    """A line for each component, a mark for each plan; lengths and angles apart."""
    shown = [plan for plan in plans if plan.predicted][:MOST]
    if not shown:
        return style.empty(
            "No predicted accuracy of the plans is stored in this result."
        )
    groups: dict[str, list[str]] = {}
    for key in components(shown):
        groups.setdefault(text.split_unit(key)[1], []).append(key)
    labels = [style.label(plan.name, 40) for plan in shown]
    columns = style.legend_columns(labels)
    rows = max(map(len, groups.values()))
    legend_rows = math.ceil(len(labels) / columns)
    figure = style.figure(0.75 + 0.27 * rows + 0.17 * legend_rows)
    panels = figure.subplots(1, len(groups), squeeze=False)[0]
    for axes, (unit, keys) in zip(panels, groups.items(), strict=True):
        _panel(axes, keys, shown, labels)
        of_unit = f" [{text.unit_symbol(unit)}]" if unit else ""
        axes.set_xlabel(f"predicted rms error{of_unit}")
    handles, names = panels[0].get_legend_handles_labels()
    legend: Any = {"loc": "outside lower center", "ncols": columns}
    figure.legend(handles[::-1], names[::-1], **legend)
    return figure


def components(plans: Sequence[PlanScore]) -> list[str]:
    """Components that any of the plans predicts, in order of appearance."""
    return list(dict.fromkeys(key for plan in plans for key in plan.predicted))


def _panel(
    axes: Axes, keys: Sequence[str], plans: Sequence[PlanScore], labels: Sequence[str]
) -> None:
    tables = [plan.predicted for plan in plans]
    rms = np.column_stack([missing.column(tables, key) for key in keys])
    rms[~(rms > 0.0)] = np.nan
    rows = np.arange(len(keys))
    finite = np.isfinite(rms).any(axis=0)
    least = np.nanmin(rms[:, finite], axis=0)
    most = np.nanmax(rms[:, finite], axis=0)
    axes.hlines(
        rows[finite],
        least,
        most,
        color=style.LIGHT,
        lw=1.0,
    )
    # The chosen plan is the first: drawn last, it lies on top.
    for k in reversed(range(len(plans))):
        look: Any = {"color": style.CYCLE[k % len(style.CYCLE)], "ls": ""}
        look |= {"marker": style.marker(k), "ms": 6 if k == 0 else 5}
        look |= {"mec": "white", "mew": 0.4, "zorder": 4.0 - 0.1 * k}
        axes.plot(
            rms[k],
            rows,
            label=labels[k],
            **look,
        )
    if finite.any():
        axes.set_xlim(float(least.min()) / 1.35, 1.35 * float(most.max()))
    style.log_axis(axes, "x")
    stems = [text.split_unit(key)[0] for key in keys]
    style.fixed_ticks(axes, "y", rows.tolist(), stems)
    axes.set_ylim(len(keys) - 0.5, -0.5)
