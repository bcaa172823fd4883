"""Figures of a plan: accuracy after each stage, stages over time, accuracy against time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import AlternativePlan, PlanSection, SequenceRecord, StageRecord
from pkm_reports import missing, style, text
from pkm_reports.missing import or_nan

# Accuracy of each pose component after each stage of a plan, on a log scale.

REALISED: Final = "realised, virtual machines"
WANTED: Final = "wanted"
MOST_TICKS: Final = 12
#: shift of the diamonds, so that the line's own marks do not hide them
BESIDE: Final = 0.09


def draw_accuracies(plan: PlanSection) -> Figure:
    """A line for each component; lengths and angles have panels of their own."""
    keys = components(plan)
    if not keys:
        return style.empty("No accuracy after the stages is stored in this result.")
    units = list(dict.fromkeys(text.split_unit(key)[1] for key in keys))
    figure = style.figure(2.9)
    panels = figure.subplots(1, len(units), squeeze=False)[0]
    for axes, unit in zip(panels, units, strict=True):
        for k, key in enumerate(keys):
            if text.split_unit(key)[1] == unit:
                colour = style.CYCLE[k % len(style.CYCLE)]
                _component(axes, key, plan, colour, style.marker(k))
        of_unit = f" [{text.unit_symbol(unit)}]" if unit else ""
        axes.set(xlabel="after stage", ylabel=f"rms error{of_unit}")
        _set_ticks(axes, len(plan.stages))
        style.log_axis(axes, "y")
    entries = style.legend_entries(panels)
    for label in (WANTED, REALISED):  # the last entries of the legend
        if label in entries:
            entries[label] = entries.pop(label)
    style.legend_below(figure, entries)
    return figure


def components(plan: PlanSection) -> list[str]:
    """Names with units (`z_um`) of components with at least one positive accuracy."""
    tables = [plan.start_accuracy, *[stage.accuracy for stage in plan.stages]]
    positive = [key for table in tables for key, rms in table.items() if rms > 0.0]
    return list(dict.fromkeys(positive))


def realised(stage: StageRecord) -> dict[str, float]:
    """Accuracy that virtual machines reached: the prediction times their ratio to it."""
    ratios = {key: component_label(stage.realised, key) for key in stage.accuracy}
    reached = {key: ratios[key] * rms for key, rms in stage.accuracy.items()}
    return {key: rms for key, rms in reached.items() if math.isfinite(rms)}


def component_label(table: Mapping[str, float], key: str) -> float:
    """The number of a component, stored with its unit in the name or without."""
    return missing.entry(table, key if key in table else stem(key))


def stem(key: str) -> str:
    """The component's name without its unit: z_um -> z."""
    return key.rpartition("_")[0] if text.split_unit(key)[1] else key


def _component(
    axes: Axes, key: str, plan: PlanSection, colour: str, marker: str
) -> None:
    at = np.arange(len(plan.stages) + 1)
    tables = [plan.start_accuracy, *[stage.accuracy for stage in plan.stages]]
    predicted = _positive(missing.column(tables, key))
    label = style.label(text.split_unit(key)[0])
    axes.plot(at, predicted, color=colour, marker=marker, label=label)
    tables = [{}, *[realised(stage) for stage in plan.stages]]
    reached = _positive(missing.column(tables, key))
    if np.isfinite(reached).any():
        axes.plot(at + BESIDE, reached, "D", label=REALISED, **style.DIAMOND)
    wanted = missing.entry(plan.goal, key)
    if wanted > 0.0:
        axes.axhline(wanted, color=colour, ls=":", lw=1.0)
        axes.plot(
            [],
            [],
            color=style.GREY,
            ls=":",
            lw=1.0,
            label=WANTED,
        )


def _positive(values: Array) -> Array:
    """Numbers; NaN for what a log axis cannot show."""
    return np.where(values > 0.0, values, np.nan)


def _set_ticks(axes: Axes, count: int) -> None:
    """`before`, then the stages by number; of many stages, every other or so."""
    step = 1 + (count - 1) // MOST_TICKS
    places = [0, *range(step, count + 1, step)]
    style.fixed_ticks(axes, "x", places, ["before", *[str(k) for k in places[1:]]])
    axes.set_xlim(-0.25, count + 0.3)


# The stages of a plan over time, against the budget.

#: shares of the axis: bars that end after the first have their words inside or before
LATE, ROOM_BEFORE = 0.62, 0.38


def draw_timeline(plan: PlanSection) -> Figure:
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


#: sequences shown by name; more are in the table only
MAX_PARETO_PLANS: Final = 6
#: a range of minutes wider than this factor is drawn on a log scale
WIDE: Final = 30.0
GOAL_LABEL: Final = "error of the worst component\nover its wanted accuracy"
NO_GOAL_LABEL: Final = (
    "remaining error over that\nbefore any reading (rms of components)"
)


def draw_front(plan: PlanSection) -> Figure:
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
    _draw_sequences(axes, compared[:MAX_PARETO_PLANS])
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
