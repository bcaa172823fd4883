"""Accuracy against time: the Pareto front of plans, the plan, its bound, sequences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import AlternativePlan, PlanSection, SequenceRecord
from pkm_reports import missing, style, text
from pkm_reports.missing import or_nan

#: sequences shown by name; more are in the table only
MOST: Final = 6
#: a range of minutes wider than this factor is drawn on a log scale
WIDE: Final = 30.0
GOAL_LABEL: Final = "error of the worst component\nover its wanted accuracy"
NO_GOAL_LABEL: Final = (
    "remaining error over that\nbefore any reading (rms of components)"
)


def draw(plan: PlanSection) -> Figure:
    """Minutes against the value that plans are judged by, the smaller the better."""
    front = points(plan.front)
    chosen = _points([(plan.cost, or_nan(plan.value))])
    compared = [s for s in plan.compared if len(points([s.sequence]))]
    rejected = points(alternatives(plan))
    sequences = points([s.sequence for s in compared])
    plans = np.vstack([front, chosen, rejected, sequences])
    if not len(plans):
        return style.empty("No plans of other times are stored in this result.")
    figure = style.figure(3.3)
    axes = figure.subplots()
    _set_limits(axes, plans, plan)
    _draw_limits(axes, plan)
    if len(rejected):
        axes.plot(
            *rejected.T,
            "x",
            color=style.GREY,
            ms=5,
            label="considered",
        )
    if len(front):
        line: Any = {"color": style.BLUE, "drawstyle": "steps-post"}
        axes.plot(*front.T, "o-", label="best plan found for the time", **line)
    _draw_sequences(axes, compared[:MOST])
    if len(chosen):
        star: Any = {
            "color": style.ORANGE,
            "mec": style.INK,
            "mew": 0.6,
            "ms": 12,
        }
        axes.plot(
            *chosen.T,
            "*",
            label="the plan",
            zorder=5,
            **star,
        )
    style.log_axis(axes, "y")
    axes.set(xlabel="minutes", ylabel=GOAL_LABEL if plan.goal else NO_GOAL_LABEL)
    entries = style.legend_entries([axes])
    style.legend_below(figure, entries, min(2, style.legend_columns(list(entries))))
    return figure


def alternatives(plan: PlanSection) -> list[AlternativePlan]:
    """Plans that were considered and not taken; some results hold sentences as well."""
    return [entry for entry in plan.alternatives if isinstance(entry, AlternativePlan)]


def points(plans: Sequence[AlternativePlan]) -> Array:
    """Minutes and value (n, 2) of the plans whose value is positive."""
    return _points([(plan.minutes, plan.value) for plan in plans])


def _points(pairs: Sequence[tuple[float, float]]) -> Array:
    table = np.array(pairs, dtype=float).reshape(-1, 2)
    finite, positive = np.isfinite(table).all(axis=1), table[:, 1] > 0.0
    return np.asarray(table[finite & positive])


def _set_limits(axes: Axes, plans: Array, plan: PlanSection) -> None:
    """Limits that hold all plans, the budget and the bounds."""
    minutes = np.append(plans[:, 0], missing.finite([plan.budget_min]))
    bounds = missing.finite([plan.bound, *[s.bound for s in plan.compared]])
    bounds += [1.0] if plan.goal else []
    values = np.append(plans[:, 1], [bound for bound in bounds if bound > 0.0])
    axes.set_yscale("log")
    axes.set_ylim(values.min() / 1.35, 1.35 * values.max())
    positive = minutes[minutes > 0.0]
    if len(positive) and positive.max() > WIDE * positive.min():
        axes.set_xscale("log")
        axes.set_xlim(positive.min() / 1.2, 1.12 * positive.max())
        style.log_axis(axes, "x")
    else:
        axes.set_xlim(0.0, 1.06 * max(minutes.max(), 1e-9))


def _draw_limits(axes: Axes, plan: PlanSection) -> None:
    """Shade what no plan reaches, and mark the budget and the goal."""
    start, end = axes.get_xlim()
    budget, bound = or_nan(plan.budget_min), or_nan(plan.bound)
    if bound > 0.0:
        span = [start, budget if math.isfinite(budget) else end]
        shade: Any = {"color": style.LIGHT, "lw": 0, "zorder": 0}
        label = "no plan within the budget is better"
        axes.fill_between(
            span,
            axes.get_ylim()[0],
            bound,
            label=label,
            **shade,
        )
        axes.plot(
            span,
            [bound, bound],
            color=style.GREY,
            lw=0.8,
        )
    if math.isfinite(budget):
        label = f"budget: {text.trimmed(budget)} min"
        axes.axvline(
            budget,
            color=style.RED,
            ls="--",
            lw=1.0,
            label=label,
        )
    if plan.goal:
        label = "below: the goal is reached"
        axes.axhline(
            1.0,
            color=style.GREEN,
            ls=":",
            lw=1.3,
            label=label,
        )


def _draw_sequences(axes: Axes, compared: Sequence[SequenceRecord]) -> None:
    """Sequences that the study asked for, each with the bound of its time below it."""
    for k, record in enumerate(compared):
        point = points([record.sequence])
        look: Any = {
            "marker": "DsP^vX"[k % 6],
            "ls": "",
            "ms": 6,
            "mew": 0.5,
        }
        look |= {"color": style.CYCLE[(k + 2) % len(style.CYCLE)], "mec": style.INK}
        axes.plot(
            *point.T,
            label=style.label(f"sequence {record.name}", 48),
            **look,
        )
        if record.bound > 0.0:
            label = "bound of a sequence's time" if k == len(compared) - 1 else None
            dash: Any = {"color": style.INK, "ms": 10, "mew": 1.4}
            axes.plot(
                point[:, 0],
                [record.bound],
                "_",
                label=label,
                **dash,
            )
