"""Chapter: how good the plan is: its certificate, and comparisons with other plans."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import DesignSection, HowManySummary, RobustSummary, StudyResult
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections import recording
from pkm_reports.sections.design import certificate, criteria, plans
from pkm_reports.sections.design.certificate import criterion_value

# The robust and the nominal plan over the scenarios, as cumulative distributions.

#: factor between the limits from which the axis is logarithmic
WIDE = 8.0


def draw_robust(robust: RobustSummary) -> Figure:
    """Share of the scenarios in which a plan is worth no more than so much."""
    values = missing.array(robust.values)
    nominal = missing.array(robust.nominal_values)
    finite = [v for v in (values, nominal) if np.isfinite(v).any()]
    if not finite:
        return style.empty("No values of the scenarios are stored in this result.")
    best = max(float(np.nanmax(v)) for v in finite)
    figure = style.figure(2.7)
    axes = figure.subplots()
    if robust.risk == "cvar" and 0.0 < robust.level < 1.0:
        label = f"the worst {text.percent(robust.level)}: their mean counts"
        shade: Any = {
            "color": style.SHADE,
            "lw": 0,
            "zorder": 0,
            "label": label,
        }
        axes.axhspan(0.0, 100.0 * robust.level, **shade)
    _distribution(axes, nominal, robust.nominal, best, "nominal plan", 1)
    _distribution(axes, values, robust.value, best, "robust plan", 0)
    axes.set_xlabel("worth in a scenario [% of the best one of all]")
    axes.set_ylabel("share of the scenarios [%]")
    axes.set_ylim(0.0, 104.0)
    low, high = axes.get_xlim()
    if low > 0.0 and high > WIDE * low:
        style.log_axis(axes, "x")
    style.legend_below(figure, style.legend_entries([axes]))
    return figure


def _distribution(
    axes: Axes, values: Array, by_risk: float, best: float, label: str, k: int
) -> None:
    """The scenarios of a plan, worst first; a dashed line at its worth by the risk."""
    values = np.sort(values[np.isfinite(values)])
    if not len(values):
        return
    colour = style.CYCLE[k]
    worth = 100.0 * np.exp(values - best)
    share = 100.0 * np.arange(1, len(values) + 1) / len(values)
    look: Any = {
        "marker": style.marker(k),
        "ms": 3.5,
        "drawstyle": "steps-post",
    }
    axes.plot(worth, share, color=colour, label=f"{label}, each scenario", **look)
    dashed: Any = {"color": colour, "ls": "--", "lw": 1.0}
    if np.isfinite(by_risk):
        worth_by_risk = 100.0 * float(np.exp(by_risk - best))
        axes.axvline(worth_by_risk, label=f"{label}, by the risk", **dashed)


# Accuracy over the number of readings, with the bound for each number.

MOST_COLUMNS: Final = 3
MOST_TICKS: Final = 5


def draw_how_many(summary: HowManySummary) -> Figure:
    """A panel for each component: plans found, the bound below, the wanted accuracy."""
    sizes = missing.array(summary.sizes)
    names = [
        name
        for name, values in summary.accuracy.items()
        if len(values) == len(sizes) and missing.finite(values)
    ]
    if not names:
        return style.empty(
            "No accuracy over the number of readings is stored in this result."
        )
    columns = 2 if len(names) == 4 else min(MOST_COLUMNS, len(names))
    rows = math.ceil(len(names) / columns)
    figure = style.figure(0.65 + (2.6 if columns == 1 else 2.05) * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, (axes, name) in enumerate(zip(grid, names, strict=False)):
        _panel(axes, name, sizes, summary)
        if k + columns >= len(names):
            axes.set_xlabel("number of readings")
    style.hide(grid[len(names) :])
    style.legend_below(figure, style.legend_entries(grid))
    return figure


def _panel(
    axes: Axes,
    name: str,
    sizes: Array,
    summary: HowManySummary,
) -> None:
    reached = missing.array(summary.accuracy[name])
    bound = _bound(summary.bound, name, len(sizes))
    wanted = missing.entry(summary.wanted, name)
    values = np.concatenate([reached, bound, [wanted]])
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = float(values.min()) / 1.3, 1.3 * float(values.max())
    if np.isfinite(bound).any():
        label = "no plan of as many readings is better"
        axes.fill_between(
            sizes,
            low,
            bound,
            color=style.LIGHT,
            lw=0,
            label=label,
        )
        axes.plot(sizes, bound, color=style.GREY, lw=0.8)
    axes.plot(sizes, reached, "o-", color=style.BLUE, label="plans found")
    if np.isfinite(wanted):
        axes.axhline(
            wanted,
            color=style.RED,
            ls="--",
            lw=1.0,
            label="wanted",
        )
    if summary.fewest is not None:
        label = f"fewest that reach all wanted: {summary.fewest}"
        line: Any = {"color": style.GREEN, "ls": ":", "lw": 1.3}
        axes.axvline(summary.fewest, label=label, **line)
    axes.set_ylim(low, high)
    axes.set_xscale("log")
    axes.set_xlim(float(sizes.min()) / 1.08, 1.08 * float(sizes.max()))
    style.log_axis(axes, "y")
    ticks = _ticks(sizes)
    style.fixed_ticks(axes, "x", ticks, [text.trimmed(n) for n in ticks])
    axes.set_title(style.label(text.heading(name)))


def _bound(
    bounds: Mapping[str, Sequence[float | None]],
    name: str,
    count: int,
) -> Array:
    """The bound at each number of readings, NaN where it is not known."""
    if name not in bounds or len(bounds[name]) != count:
        return np.full(count, np.nan)
    return missing.array(bounds[name])


def _ticks(sizes: Array) -> Sequence[float]:
    """A few of the sizes, evenly apart on a log axis, both ends among them."""
    if len(sizes) <= MOST_TICKS:
        return [float(n) for n in sizes]
    places = np.geomspace(sizes[0], sizes[-1], MOST_TICKS)
    nearest = [int(np.argmin(np.abs(np.log(sizes / size)))) for size in places]
    return sorted({float(sizes[k]) for k in nearest})


def blocks(result: StudyResult) -> list[Block]:
    """Certificate, polishing, reference plans, criteria, effects, scenarios, number of readings."""
    design = result.design
    if design is None:
        return []
    return [
        *certificate.blocks(design),
        *_polish(design),
        *plans.blocks(design),
        *criteria.blocks(design),
        *_effects(design),
        *_robust(design),
        *_how_many(design),
    ]


CHAPTER: Final = Chapter("design", "How good the plan is", blocks)


# -- poses and set-ups polished off the grid -------------------------------------------


def _polish(design: DesignSection) -> list[Block]:
    """Criterion before and after, and the set-ups that moved."""
    polish = design.polished
    if polish is None:
        return []
    criterion = design.criterion
    before = criterion_value(criterion, polish.before)
    after = criterion_value(criterion, polish.after)
    sentence = f"Polishing off the grid brings criterion {criterion}"
    sentence += f" from {before} to {after}"
    if polish.before == polish.after:
        sentence = f"Polishing off the grid leaves criterion {criterion} at {after}"
    if polish.words and polish.words not in design.words:
        sentence += f": {polish.words}"
    content: list[Block] = [Paragraph(text.sentence(sentence))]
    if polish.setups:
        columns = [TableColumn("Set-up"), wide_column("Set it to")]
        rows = [
            [name, text.named_quantities(settings)]
            for name, settings in polish.setups.items()
        ]
        count = text.count(len(rows), "set-up")
        caption = f"New settings of the set-ups that polishing moved: {count}."
        content.append(Table(columns, rows, caption))
    return content


# -- the plan that allows for effects, beside one for a machine without ----------------


def _effects(design: DesignSection) -> list[Block]:
    """A sentence, and the accuracy of both plans."""
    allowed = design.effects
    if allowed is None:
        return []
    with_effects = _difference(allowed.efficiency)
    alone = _difference(allowed.efficiency_without)
    sentence = (
        f"The plan allows for {text.count(allowed.groups, 'group')} of effects beside the"
        f" geometry, {_sizes(allowed.size)}. On a machine that has them at the sizes expected"
        f" of them, the plan for a machine without effects {with_effects} by"
        f" {design.criterion}; on a machine without effects, this plan {alone}."
    )
    columns = [
        wide_column("Error after compensation, rms"),
        *number_columns("before any reading", "this plan", "plan without effects"),
    ]
    rows = []
    for key, value in allowed.accuracy.items():
        stem, unit = text.split_unit(key)
        values = (allowed.before[key], value, allowed.accuracy_without[key])
        rows.append([stem, *(text.quantity(v, unit) for v in values)])
    caption = (
        "Predicted errors over the workspace of a machine with these effects, once all that"
        " is known is corrected."
    )
    table = Table(columns, rows, caption)
    return [Paragraph(sentence), table, *recording.blocks(allowed.recording)]


def _difference(efficiency: float) -> str:
    """What a plan loses, or gains, against another one."""
    verb = "loses" if efficiency <= 1.0 else "gains"
    return f"{verb} {text.percent(abs(1.0 - efficiency))}"


def _sizes(factor: float) -> str:
    """The sizes that the plan is chosen for, as a factor on the expected ones."""
    if factor == 1.0:
        return "at the sizes expected of them"
    return (
        f"at {factor:.2g} times the sizes expected of them, the typical size on a healthy"
        " machine"
    )


# -- the robust plan over many machines and set-ups ------------------------------------


RISKS: Final = {"mean": "the mean over all", "worst": "the worst"}


def _robust(design: DesignSection) -> list[Block]:
    """A sentence, and the scenarios of both plans."""
    summary = design.robust
    if summary is None:
        return []
    caption = _robust_caption(summary)
    return [
        Paragraph(_robust_sentence(summary)),
        Picture("robust", lambda: draw_robust(summary), caption),
    ]


def _robust_sentence(summary: RobustSummary) -> str:
    scenarios = text.count(summary.scenarios, "scenario")
    gain = text.times(math.exp(summary.value - summary.nominal))
    share = text.percent_at_least(summary.efficiency)
    return (
        f"The plan is robust: it is judged by {_risk(summary)} of {scenarios}, machines"
        " and set-ups drawn within what is known of them beforehand. By that risk it is"
        f" worth {gain} the plan for the nominal machine, and is certified to {share} of"
        " the best possible."
    )


def _risk(summary: RobustSummary) -> str:
    if summary.risk == "cvar":
        return f"the mean of the worst {text.percent(summary.level)}"
    return text.meaning(summary.risk, RISKS)


def _robust_caption(summary: RobustSummary) -> str:
    """In how many scenarios the robust plan is ahead."""
    caption = (
        "Worth of the robust and of the nominal plan in each scenario, exp(value −"
        " largest value of all), worst first. Dashed: by the risk of the study. Right"
        " is better."
    )
    pairs = list(zip(summary.values, summary.nominal_values, strict=False))
    if not pairs:
        return caption
    ahead = sum(or_nan(value) > or_nan(nominal) for value, nominal in pairs)
    return f"{caption} The robust plan is ahead in {ahead} of {len(pairs)}."


# -- how many readings a wanted accuracy needs -----------------------------------------


def _how_many(design: DesignSection) -> list[Block]:
    """A sentence, and accuracy over the number of readings."""
    summary = design.how_many
    if summary is None:
        return []
    caption = _how_many_caption(summary)
    return [
        Paragraph(_how_many_sentence(summary)),
        Picture("how_many", lambda: draw_how_many(summary), caption),
    ]


def _how_many_sentence(summary: HowManySummary) -> str:
    """The sentence of the study, or the same from the numbers."""
    wanted = text.named_quantities(summary.wanted, 4)
    if summary.words:
        verdict = text.sentence(summary.words)
        return f"Wanted: {wanted}. {verdict}" if summary.wanted else verdict
    if not summary.wanted:
        return (
            "The study asks for no accuracy: the figure shows what each number of"
            " readings reaches."
        )
    if summary.fewest is None:
        return (
            f"No plan found with up to {summary.most} readings reaches {wanted}; none"
            f" with fewer than {summary.at_least} can."
        )
    readings = text.count(summary.fewest, "reading")
    if summary.fewest == summary.at_least:
        return f"A plan of {readings} reaches {wanted}; fewer cannot (proven)."
    return (
        f"A plan of {readings} reaches {wanted}; fewer than {summary.at_least} readings"
        " cannot."
    )


def _how_many_caption(summary: HowManySummary) -> str:
    """First and last point of each curve."""
    caption = (
        "Predicted rms error over the number of readings, both on log scales. Dots are"
        " plans found; no plan of as many readings lies in the shaded region."
    )
    sizes = summary.sizes
    ranges = []
    for key, values in summary.accuracy.items():
        if len(values) == len(sizes) > 1:
            stem, unit = text.split_unit(key)
            first, last = (
                text.quantity(values[0], unit),
                text.quantity(values[-1], unit),
            )
            ranges.append(f"{stem} from {first} to {last}")
    if not ranges:
        return caption
    return f"{caption} From {sizes[0]} to {sizes[-1]} readings: {text.listing(ranges)}."
