"""Several results side by side: two plans, before and after, sessions of one machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

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
    Items,
    Paragraph,
    Picture,
    Section,
    Table,
    TableColumn,
)
from pkm_reports.sections.answer import REFERENCES, wanted_accuracy
from pkm_reports.sections.gap import explanation_row
from pkm_reports.sections.machine_figures import draw_overview
from pkm_reports.sections.measure import is_plan, used_setups

# What differs between results, in sentences and in one table.

Results = Mapping[str, StudyResult]
MIN_DIFFERENCE_RATIO: Final = 1.02  #: ratio from which two accuracies or times differ


def sentences(results: Results) -> list[Block]:
    """Differences of machine, time, rank and accuracy; that there are none, if so."""
    agreement = "The results agree in machine, time, rank and predicted accuracy."
    lines = [*_machines(results), *_times(results), *_ranks(results), *_best(results)]
    return [Items(lines)] if lines else [Paragraph(agreement)]


def minutes(result: StudyResult) -> float:
    """Time of the plan; NaN where there is none."""
    design, plan = result.design, result.plan
    if not is_plan(result):
        return math.nan
    if design is not None and design.order is not None:
        return design.order.minutes
    if design is not None and design.cost_min is not None:
        return design.cost_min
    return math.nan if plan is None else plan.cost


def _machines(results: Results) -> Iterator[str]:
    machines = {r.machine.name for r in results.values()}
    if len(machines) > 1:
        yield "The machines differ, so parameters are not compared."


def _times(results: Results) -> Iterator[str]:
    times = {n: minutes(r) for n, r in results.items() if math.isfinite(minutes(r))}
    if len(times) < 2:
        return
    short, long = min(times, key=lambda n: times[n]), max(times, key=lambda n: times[n])
    if times[long] > MIN_DIFFERENCE_RATIO * times[short]:
        yield (
            f"{short} takes the least time, {text.quantity(times[short], 'min', 2)},"
            f" and {long} the most, {text.quantity(times[long], 'min', 2)}."
        )


def _ranks(results: Results) -> Iterator[str]:
    ranks = {
        name: r.identifiability.rank
        for name, r in results.items()
        if r.identifiability is not None
    }
    if len(set(ranks.values())) > 1:
        counts = [f"{rank} in {name}" for name, rank in ranks.items()]
        yield f"Directions that the readings determine: {text.listing(counts)}."


def _best(results: Results) -> Iterator[str]:
    """For each component which result is the most accurate, and by how much."""
    uncorrected = _uncorrected(results)
    references = {
        label: text.meaning(section.reference, REFERENCES)
        for label, result in results.items()
        if (section := result.judged_prediction) is not None
    }
    if len(set(references.values())) > 1:
        listed = [f"{label} {phrase}" for label, phrase in references.items()]
        yield (
            f"Errors have different references: {text.listing(listed)}; so their sizes"
            " say nothing about which result is better."
        )
        return
    for name, sizes in rms_by_component(results).items():
        if len(sizes) < 2:
            continue
        best = min(sizes, key=lambda n: sizes[n][0])
        worst = max(sizes, key=lambda n: sizes[n][0])
        (low, unit), (high, other) = sizes[best], sizes[worst]
        if unit != other or not high > MIN_DIFFERENCE_RATIO * low > 0.0:
            continue
        noun = "unknown part" if name in uncorrected else "error"
        subject = f"The {noun} of {name}"
        yield (
            f"{subject} is smallest in {best}: {text.quantity(low, unit)} rms,"
            f" {text.number(high / low, 2)} times as good as in {worst}."
        )


def _uncorrected(results: Results) -> set[str]:
    """Components that the controller of any of the machines does not correct."""
    predictions = [r.judged_prediction for r in results.values()]
    return {
        name
        for prediction in predictions
        if prediction is not None
        for name, component in prediction.components.items()
        if not component.compensatable
    }


def rms_by_component(results: Results) -> dict[str, dict[str, tuple[float, str]]]:
    """Rms afterwards, of what no drive corrects the unknown part, and unit, by component."""
    sizes: dict[str, dict[str, tuple[float, str]]] = {}
    for label, result in results.items():
        prediction = result.judged_prediction
        if prediction is None:
            continue
        for name, c in prediction.judged_components.items():
            sizes.setdefault(name, {})[label] = (c.judged.rms, c.judged.unit)
    return sizes


def _readings(result: StudyResult) -> str:
    if result.design is not None:
        return str(result.design.n)
    if result.estimate is not None:
        return str(result.estimate.readings)
    stages = [] if result.plan is None else result.plan.stages
    return str(sum(stage.readings for stage in stages)) if stages else text.MISSING


def _setups(result: StudyResult) -> str:
    setups = used_setups(result)
    return text.listing(f"{s.name} ({s.instrument})" for s in setups)


def _determined(result: StudyResult) -> str:
    section = result.identifiability
    return text.MISSING if section is None else f"{section.rank} of {section.n}"


def _certificate(result: StudyResult) -> str:
    design = result.design
    if design is None or design.efficiency is None:
        return text.MISSING
    share = text.percent_at_least(design.efficiency)
    return f"{design.criterion}: at least {share} of the best"


def _residual(result: StudyResult) -> str:
    estimate = result.final_estimate
    if estimate is None:
        return text.MISSING
    return text.listing(
        f"{name} {text.channel_value(name, value, estimate.units)}"
        for name, value in estimate.rms_after.items()
    )


def _claims(result: StudyResult) -> str:
    if not result.claims:
        return text.MISSING
    met = sum(claim.met for claim in result.claims)
    return f"{met} of {len(result.claims)} met"


ROWS: Final[tuple[tuple[str, Callable[[StudyResult], str]], ...]] = (
    ("Study", lambda result: result.title or result.study),
    ("Machine", lambda result: result.machine.name),
    ("Set-ups", _setups),
    ("Readings", _readings),
    ("Time", lambda result: text.quantity(minutes(result), "min", 2)),
    ("Determined", _determined),
    ("Certificate", _certificate),
    ("Residual after the fit, rms", _residual),
    ("Claims", _claims),
    ("Warnings", lambda result: str(len(result.warnings))),
)


def glance_blocks(results: Results) -> list[Block]:
    """One row a fact, one column a result; rows without a fact are left out."""
    rows = []
    for title, cell in ROWS:
        cells = [cell(result) for result in results.values()]
        if any(words != text.MISSING for words in cells):
            rows.append([title, *cells])
    columns = [TableColumn("What"), *[TableColumn(name, wide=True) for name in results]]
    return [Table(columns, rows, f"{len(results)} results side by side.")]


# Predicted accuracy of several results as bars side by side.

#: share of the distance between two components that their bars take
BAR_WIDTH_SHARE = 0.8
Sizes = Mapping[str, tuple[float, str]]


def draw_side_by_side(sizes: Mapping[str, Sizes], names: Sequence[str]) -> style.Figure:
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
        _side_panel(axes, group, names)
        axes.set_ylabel(f"rms error [{text.unit_symbol(unit)}]")
    style.legend_below(figure, style.legend_entries(grid[0]))
    return figure


def _side_panel(
    axes: style.Axes, group: Mapping[str, Sizes], names: Sequence[str]
) -> None:
    places = np.arange(len(group))
    width = BAR_WIDTH_SHARE / len(names)
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


# Predicted accuracy of several results, component by component.
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
    columns = [TableColumn("Component"), *TableColumn.numbers(*names)]
    with_goals = bool(goals)
    if with_goals:
        columns += [*TableColumn.numbers("Wanted"), TableColumn("Passed by")]
    rows = [_accuracy_row(name, of, results, goals) for name, of in sizes.items()]
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


def _accuracy_row(
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
    columns = [TableColumn("Parameter"), *TableColumn.numbers(*titles, "Tolerance")]
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
        TableColumn("Likeliest explanation", wide=True),
        *TableColumn.numbers("Probability", "Residual before, rms", "after"),
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


# The plans of several results: where their readings lie, and how they score.
def plan_blocks(results: Mapping[str, StudyResult]) -> list[Block]:
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
        *TableColumn.numbers("Readings", "Candidates", "log det", "κ", "Certified"),
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


def comparison_parts(
    results: Results, changes: Sequence[str]
) -> tuple[list[Section], list[Section]]:
    """First page and chapters of a comparison of results by name."""
    answer = _present(
        Section("differences", "What differs", sentences(results)),
        Section(
            "changes",
            "What changed in the machine",
            [Items(list(changes))] if changes else [],
        ),
        Section("glance", "At a glance", glance_blocks(results)),
        Section("side-accuracy", "How accurate", accuracy_blocks(results)),
    )
    chapters = _present(
        Section("side-plans", "Plans", plan_blocks(results)),
        Section("side-parameters", "Parameters", parameter_blocks(results)),
        Section("side-causes", "Causes", cause_blocks(results)),
    )
    return answer, chapters


def _present(*sections: Section) -> list[Section]:
    return [section for section in sections if section.blocks]
