"""When each stage of a plan begins and ends, its mounting and its readings, against the
time there is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pkm_reports import style, words

Part = Mapping[str, Any]


def draw(plan: Part) -> Figure:
    """A bar for each stage, the first on top; mounting darker where it is told apart
    from reading.
    """
    stages = [
        s
        for s in plan.get("stages") or []
        if np.isfinite(words.number(s.get("begin_min")))
    ]
    if not stages:
        return style.empty("No times of stages are stored in this result.")
    figure = style.figure(0.95 + 0.34 * len(stages))
    axes = figure.subplots()
    budget = words.number(plan.get("budget_min"))
    right = np.nanmax(
        [words.number(stages[-1].get("end_min")), stages[-1]["begin_min"], budget]
    )
    for k, stage in enumerate(stages):
        _bar(axes, k, stage, float(right))
    if np.isfinite(budget):
        axes.axvline(
            budget,
            color=style.RED,
            ls="--",
            lw=1.0,
            label=f"time there is: {words.plain(budget)} min",
        )
    names = [
        f"{k + 1}  {style.safe(str(s['measurement']), 28)}"
        for k, s in enumerate(stages)
    ]
    style.fixed_ticks(axes, "y", range(len(stages)), names)
    axes.set(
        xlabel="minutes",
        ylim=(len(stages) - 0.4, -0.6),
        xlim=(0.0, 1.02 * float(right)),
    )
    axes.grid(False, axis="y")
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(
        named.values(),
        named.keys(),
        loc="outside lower center",
        ncols=style.legend_columns(list(named)),
    )
    return figure


def _bar(axes: Axes, k: int, stage: Part, right: float) -> None:
    """One stage; its readings and minutes written where there is room."""
    begin, end = float(stage["begin_min"]), words.number(stage.get("end_min"))
    end = end if np.isfinite(end) else begin + words.number(stage.get("cost"))
    mounted = words.number(stage.get("mounting_min"))
    apart = 0.0 < mounted < end - begin
    if apart:
        axes.barh(k, mounted, 0.6, left=begin, color=style.GREY, label="mounting")
    first = begin + mounted if apart else begin
    axes.barh(
        k,
        end - first,
        0.6,
        left=first,
        color=style.SKY,
        label="reading" if apart else "mounting and reading",
    )
    told = f"{words.count(stage['readings'], 'reading')}, {words.num(end - begin)} min"
    before = end > 0.62 * right  # else the words would leave the picture
    if before and begin > 0.38 * right:
        axes.text(begin, k, f"{told} ", ha="right", va="center", fontsize=7)
    elif before:
        axes.text(first, k, f" {told}", ha="left", va="center", fontsize=7)
    else:
        axes.text(end, k, f" {told}", ha="left", va="center", fontsize=7)
