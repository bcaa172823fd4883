"""The stages of a plan over time, against the budget."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.result import PlanSection, StageRecord
from pkm_reports import missing, style, text
from pkm_reports.missing import or_nan

#: shares of the axis: bars that end after the first have their words inside or before
LATE, ROOM_BEFORE = 0.62, 0.38


def draw(plan: PlanSection) -> Figure:
    """A bar for each stage, the first on top."""
    stages = [stage for stage in plan.stages if stage.begin_min is not None]
    if not stages:
        return style.empty("No times of stages are stored in this result.")
    figure = style.figure(0.95 + 0.34 * len(stages))
    axes = figure.subplots()
    last = stages[-1]
    right = max(missing.finite([last.begin_min, last.end_min, plan.budget_min]))
    for k, stage in enumerate(stages):
        _bar(axes, k, stage, right)
    if plan.budget_min is not None:
        label = f"budget: {text.trimmed(plan.budget_min)} min"
        line: Any = {"color": style.RED, "ls": "--", "lw": 1.0}
        axes.axvline(plan.budget_min, label=label, **line)
    names = [
        f"{k}  {style.label(stage.measurement, 28)}"
        for k, stage in enumerate(stages, 1)
    ]
    style.fixed_ticks(axes, "y", range(len(stages)), names)
    axes.set_xlabel("minutes")
    axes.set_xlim(0.0, 1.02 * right)
    axes.set_ylim(len(stages) - 0.4, -0.6)
    axes.grid(False, axis="y")
    style.legend_below(figure, style.legend_entries([axes]))
    return figure


def _bar(
    axes: Axes,
    k: int,
    stage: StageRecord,
    right: float,
) -> None:
    """One stage, with its readings and minutes written where there is room."""
    begin = or_nan(stage.begin_min)
    end = begin + stage.cost if stage.end_min is None else stage.end_min
    bar: Any = {"color": style.SKY, "label": "mounting and reading"}
    axes.barh(k, end - begin, 0.6, left=begin, **bar)
    readings = text.count(stage.readings, "reading")
    phrase = f"{readings}, {text.number(end - begin)} min"
    letters: Any = {"va": "center", "fontsize": 7}
    if end <= LATE * right:
        axes.text(end, k, f" {phrase}", ha="left", **letters)
    elif begin > ROOM_BEFORE * right:
        axes.text(begin, k, f"{phrase} ", ha="right", **letters)
    else:
        axes.text(begin, k, f" {phrase}", ha="left", **letters)
