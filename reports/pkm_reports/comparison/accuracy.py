"""Predicted accuracy of several results, component by component."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.result import StudyResult
from oed.verdict import accuracy_verdicts
from pkm_reports import missing, style, text
from pkm_reports.blocks import Block, Picture, Table, TableColumn, number_columns
from pkm_reports.comparison.glance import rms_by_component
from pkm_reports.sections import wanted_accuracy

# Predicted accuracy of several results as bars side by side.

#: share of the distance between two components that their bars take
BROAD = 0.8
Sizes = Mapping[str, tuple[float, str]]


def draw_side_by_side(sizes: Mapping[str, Sizes], names: Sequence[str]) -> Figure:
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


def blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """A table with what is wanted beside it, and bars."""
    sizes = rms_by_component(results)
    if not sizes:
        return []
    caption = (
        "Predicted rms error over the workspace afterwards; of what no drive corrects,"
        " the unknown part. Wanted: the strictest of the studies."
    )
    names = list(results)
    goals = _goals(results)
    columns = [TableColumn("Component"), *number_columns(*names)]
    with_goals = bool(goals)
    if with_goals:
        columns += [*number_columns("Wanted"), TableColumn("Passed by")]
    rows = [_row(name, of, results, goals) for name, of in sizes.items()]
    width = len(columns)
    table = Table(columns, [row[:width] for row in rows], caption)
    bars = "The same as bars, on a log scale."
    return [
        table,
        Picture("side_accuracy", lambda: draw_side_by_side(sizes, names), bars),
    ]


def _goals(results: Mapping[str, StudyResult]) -> dict[str, float]:
    """The strictest accuracy that a study asks for, by component and unit."""
    goals: dict[str, float] = {}
    for result in results.values():
        for key, value in wanted_accuracy(result).items():
            goals[key] = min(value, goals[key]) if key in goals else value
    return goals


def _row(
    component: str,
    sizes: Mapping[str, tuple[float, str]],
    results: Mapping[str, StudyResult],
    goals: Mapping[str, float],
) -> list[str]:
    unit = next(iter(sizes.values()))[1]
    cells = [text.number(sizes[n][0]) if n in sizes else text.MISSING for n in results]
    goal = missing.entry(goals, f"{component}_{unit}")
    stated = text.MISSING
    if math.isfinite(goal):
        passing = [
            name
            for name in sizes
            if accuracy_verdicts(results[name], {component: goal})[component].judgement
            == "pass"
        ]
        stated = text.listing(passing) or "none"
    title = f"{component} [{text.unit_symbol(unit)}]"
    return [title, *cells, text.number(goal), stated]
