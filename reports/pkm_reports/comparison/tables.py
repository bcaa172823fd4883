"""The plans of several results: where their readings lie, and how they score."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.result import (
    DesignSection,
    Drawing,
    GapSection,
    ParameterEstimate,
    StudyResult,
)
from oed.verdict import accuracy_verdicts
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Picture,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.comparison.glance import rms_by_component
from pkm_reports.sections import draw_overview, explanation_row, wanted_accuracy

# Predicted accuracy of several results, component by component.

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


def accuracy_blocks(results: Mapping[str, StudyResult]) -> list[Block]:
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


# Parameters of one machine as several results have them.

Estimates = Mapping[str, ParameterEstimate]


def parameter_blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """Value and standard deviation side by side; nothing where the machines differ."""
    if len({result.machine.name for result in results.values()}) > 1:
        return []
    estimates: dict[str, Estimates] = {
        name: result.final_estimate.parameters
        for name, result in results.items()
        if result.final_estimate is not None
    }
    if len(estimates) < 2:
        return []
    names = list(dict.fromkeys(n for of in estimates.values() for n in of))
    titles = [title for name in estimates for title in (name, "sd")]
    columns = [TableColumn("Parameter"), *number_columns(*titles, "Tolerance")]
    rows = [_parameter_row(name, list(estimates.values())) for name in names]
    caption = (
        "Identified values with their standard deviations. Values of directions that"
        " the readings do not determine rest on the tolerances: compare only what has"
        " a standard deviation far below its tolerance."
    )
    return [Table(columns, rows, caption)]


def _parameter_row(name: str, estimates: list[Estimates]) -> list[str]:
    records = [of[name] for of in estimates if name in of]
    cells = [f"{name} [{text.unit_symbol(records[0].unit)}]"]
    for of in estimates:
        if name not in of:
            cells += [text.MISSING, text.MISSING]
            continue
        decimals = text.decimals_for(of[name].sd)
        cells += [
            text.fixed(of[name].value, decimals),
            text.fixed(of[name].sd, decimals),
        ]
    return [*cells, text.trimmed(records[0].prior_sd, 3)]


# Diagnoses of several results side by side.


def cause_blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """The likeliest explanation of each result, with the residual before and after."""
    diagnoses = {n: r.gap for n, r in results.items() if r.gap is not None}
    if not diagnoses:
        return []
    columns = [
        TableColumn("Result"),
        wide_column("Likeliest explanation"),
        *number_columns("Probability", "Residual before, rms", "after"),
    ]
    rows = [_cause_row(name, gap) for name, gap in diagnoses.items()]
    caption = "The likeliest explanation of what calibration leaves."
    return [Table(columns, rows, caption)]


def _cause_row(name: str, gap: GapSection) -> list[str]:
    cells = [name, text.MISSING, text.MISSING]
    if gap.answers:
        explanation, probability, _ = explanation_row(gap.answers[0])
        cells = [name, explanation, probability]
    return [*cells, _rms(gap, gap.rms_before), _rms(gap, gap.rms_after)]


def _rms(gap: GapSection, rms: Mapping[str, float]) -> str:
    sizes = [f"{n} {text.channel_value(n, v, gap.units)}" for n, v in rms.items()]
    return text.listing(sizes) or text.MISSING


def blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """A picture of each plan, and a table of their scores."""
    content: list[Block] = []
    drawings = {n: r.drawing for n, r in results.items() if r.drawing is not None}
    for k, (name, drawing) in enumerate(drawings.items()):
        if drawing.lines and drawing.tool_points:
            content.append(_picture(k, name, drawing))
    designs = {n: r.design for n, r in results.items() if r.design is not None}
    if designs:
        content.append(_scores(designs))
    return content


def _picture(k: int, name: str, drawing: Drawing) -> Picture:
    points = text.count(len(drawing.tool_points), "reading")
    caption = f"{name}: machine at home and the tool points of {points}."
    return Picture(f"plan_{k}", lambda: draw_overview(drawing), caption)


def _scores(designs: Mapping[str, DesignSection]) -> Table:
    columns = [
        TableColumn("Result"),
        TableColumn("Criterion"),
        *number_columns("Readings", "Candidates", "log det", "κ", "Certified"),
    ]
    rows = [
        [
            name,
            design.criterion,
            str(design.n),
            str(design.candidates),
            text.fixed(design.plans[0].logdet, 2) if design.plans else text.MISSING,
            text.number(design.kappa, 4),
            text.percent_at_least(design.efficiency),
        ]
        for name, design in designs.items()
    ]
    caption = (
        "The chosen readings. log det: of their information; a larger one is better,"
        " where parameters and scaling are the same. κ: condition number. Certified:"
        " share of the best possible plan."
    )
    return Table(columns, rows, caption)
