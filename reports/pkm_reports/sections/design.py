"""Chapter: how good the plan is: its certificate, and comparisons with other plans."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.design import CRITERIA
from oed.result import (
    DesignSection,
    HowManySummary,
    PlanScore,
    RobustSummary,
    StudyResult,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    transposed,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections.criteria import criteria_blocks, criterion_value
from pkm_reports.sections.plan import recording_blocks, remaining_errors

# The robust and the nominal plan over the scenarios, as cumulative distributions.

#: factor between the limits from which the axis is logarithmic
LOG_AXIS_MIN_RANGE = 8.0


def draw_robust(robust: RobustSummary) -> style.Figure:
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
        shade: Any = {"color": style.SHADE, "lw": 0, "zorder": 0, "label": label}
        axes.axhspan(0.0, 100.0 * robust.level, **shade)
    _distribution(axes, nominal, robust.nominal, best, "nominal plan", 1)
    _distribution(axes, values, robust.value, best, "robust plan", 0)
    axes.set_xlabel("worth in a scenario [% of the best one of all]")
    axes.set_ylabel("share of the scenarios [%]")
    axes.set_ylim(0.0, 104.0)
    low, high = axes.get_xlim()
    if low > 0.0 and high > LOG_AXIS_MIN_RANGE * low:
        style.log_axis(axes, "x")
    style.legend_below(figure, style.legend_entries([axes]))
    return figure


def _distribution(
    axes: style.Axes, values: Array, by_risk: float, best: float, label: str, k: int
) -> None:
    """The scenarios of a plan, worst first; a dashed line at its worth by the risk."""
    values = np.sort(values[np.isfinite(values)])
    if not len(values):
        return
    colour = style.CYCLE[k]
    worth = 100.0 * np.exp(values - best)
    share = 100.0 * np.arange(1, len(values) + 1) / len(values)
    look: Any = {"marker": style.marker(k), "ms": 3.5, "drawstyle": "steps-post"}
    axes.plot(worth, share, color=colour, label=f"{label}, each scenario", **look)
    dashed: Any = {"color": colour, "ls": "--", "lw": 1.0}
    if np.isfinite(by_risk):
        worth_by_risk = 100.0 * float(np.exp(by_risk - best))
        axes.axvline(worth_by_risk, label=f"{label}, by the risk", **dashed)


# Accuracy over the number of readings, with the bound for each number.

MAX_COLUMNS: Final = 3
MAX_TICKS: Final = 5


def draw_how_many(summary: HowManySummary) -> style.Figure:
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
    columns = 2 if len(names) == 4 else min(MAX_COLUMNS, len(names))
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


def _panel(axes: style.Axes, name: str, sizes: Array, summary: HowManySummary) -> None:
    reached = missing.array(summary.accuracy[name])
    bound = np.full(len(sizes), np.nan)
    if name in summary.bound and len(summary.bound[name]) == len(sizes):
        bound = missing.array(summary.bound[name])
    wanted = missing.entry(summary.wanted, name)
    values = np.concatenate([reached, bound, [wanted]])
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = float(values.min()) / 1.3, 1.3 * float(values.max())
    if np.isfinite(bound).any():
        label = "no plan of as many readings is better"
        axes.fill_between(sizes, low, bound, color=style.LIGHT, lw=0, label=label)
        axes.plot(sizes, bound, color=style.GREY, lw=0.8)
    axes.plot(sizes, reached, "o-", color=style.BLUE, label="plans found")
    if np.isfinite(wanted):
        axes.axhline(wanted, color=style.RED, ls="--", lw=1.0, label="wanted")
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


def _ticks(sizes: Array) -> Sequence[float]:
    """A few of the sizes, evenly apart on a log axis, both ends among them."""
    if len(sizes) <= MAX_TICKS:
        return [float(n) for n in sizes]
    places = np.geomspace(sizes[0], sizes[-1], MAX_TICKS)
    nearest = [int(np.argmin(np.abs(np.log(sizes / size)))) for size in places]
    return sorted({float(sizes[k]) for k in nearest})


# Chapter: how good the plan is: its certificate, and comparisons with other plans.
def blocks(result: StudyResult) -> list[Block]:
    """Certificate, polishing, reference plans, criteria, effects, scenarios, number of readings."""
    design = result.design
    if design is None:
        return []
    return [
        *certificate_blocks(design),
        *_polish(design),
        *plan_blocks(design),
        *criteria_blocks(design),
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
        columns = [TableColumn("Set-up"), TableColumn("Set it to", wide=True)]
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
    errors = {
        "before any reading": allowed.before,
        "this plan": allowed.accuracy,
        "plan without effects": allowed.accuracy_without,
    }
    caption = (
        "Predicted errors over the workspace of a machine with these effects, once all that"
        " is known is corrected."
    )
    table = remaining_errors(errors, allowed.accuracy, caption)
    return [Paragraph(sentence), table, *recording_blocks(allowed.recording)]


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


# The certificate of the chosen readings: in words, in numbers, and refusals.

NO_GAP: Final = 1e-9  #: duality gap that is written as none


def certificate_blocks(design: DesignSection) -> list[Block]:
    """Sentence, numbers, refusals."""
    columns = [
        TableColumn("Quantity"),
        TableColumn("Of the chosen readings", wide=True),
    ]
    rows = [[name, value] for name, value in _facts(design) if value]
    table = Table(columns, rows, _certificate_caption(design))
    return [Paragraph(certificate_sentence(design)), table, *_refusals(design)]


def certificate_sentence(design: DesignSection) -> str:
    """How good the choice is known to be."""
    if design.words:
        return text.sentence(design.words)
    readings = text.count(design.n, "reading")
    if design.candidates:
        readings += f" out of {text.count(design.candidates, 'candidate')}"
    if design.proven:
        return (
            f"Proven optimal: no other choice of {readings} is better by criterion"
            f" {design.criterion}."
        )
    if design.efficiency is not None:
        share = text.percent_at_least(design.efficiency)
        return f"Certified to {share} of the best possible {readings}."
    return (
        f"The best {readings} found by criterion {design.criterion}; no bound is known."
    )


def _facts(design: DesignSection) -> Iterator[tuple[str, str]]:
    """Name and value of all that is stored; what is missing has an empty value."""
    criterion, setups = design.criterion, design.setups
    entry = CRITERIA.entry(criterion)
    yield "Criterion", f"{criterion}: {entry.meaning}" if entry else criterion
    yield "Shares", _shares(design)
    yield "Value", criterion_value(criterion, design.value)
    yield "Bound", _certified_bound(design)
    yield "Certificate", _certificate(design)
    yield "Duality gap", _duality_gap(design)
    yield "Directions determined", _directions(design)
    yield "Readings", _readings(design)
    yield "Candidates", str(design.candidates or "")
    yield "Set-ups, in working order", text.listing(setups, 20)
    yield "Cost", _cost(design)
    yield "Condition number", text.number(design.kappa, 4)
    yield "Scaling of the parameters", design.scaling


def _shares(design: DesignSection) -> str:
    total = sum(design.compound.values()) or 1.0
    return text.listing(
        f"{text.percent(weight / total)} {name}"
        for name, weight in design.compound.items()
    )


def _certified_bound(design: DesignSection) -> str:
    if design.bound is None:
        return ""
    bound = criterion_value(design.criterion, design.bound)
    return f"{bound}: no choice is {_better(design)}"


def _better(design: DesignSection) -> str:
    entry = CRITERIA.entry(design.criterion)
    return "smaller" if entry is not None and entry.smaller_is_better else "larger"


def _certificate(design: DesignSection) -> str:
    if design.proven:
        return "proven optimal"
    if design.efficiency is not None:
        share = text.percent_at_least(design.efficiency)
        return f"at least {share} of the best possible"
    polish = design.polished
    if polish is not None and polish.before != polish.after:
        return "only of the choice before polishing: the bound holds on the grid"
    return "no bound is known" if design.bound is None else ""


def _duality_gap(design: DesignSection) -> str:
    """How much of the distance to the bound may come from the bound itself."""
    gap = design.gap
    if gap is None:
        return ""
    if gap <= NO_GAP:
        return "none: weights on the candidates reach the bound"
    return f"the bound may be up to {text.percent(math.expm1(gap))} too high"


def _directions(design: DesignSection) -> str:
    if not design.directions or not design.columns:
        return ""
    return f"{design.directions} of {design.columns}"


def _readings(design: DesignSection) -> str:
    if not design.retained:
        return str(design.n)
    return f"{design.n}, of which {design.retained} belong to the earlier plan"


def _cost(design: DesignSection) -> str:
    if design.cost_min is None:
        return ""
    return f"{text.quantity(design.cost_min, 'min')} for mounting and reading"


def _certificate_caption(design: DesignSection) -> str:
    """Value and bound once more: what one compares first."""
    criterion = design.criterion
    value = criterion_value(criterion, design.value)
    caption = f"The choice in numbers: by criterion {criterion} it reaches {value}"
    if design.effects is not None:
        caption += " with the effects that it allows for"
    if design.bound is None:
        return f"{caption}."
    bound = criterion_value(criterion, design.bound)
    return f"{caption}, and the best possible is no {_better(design)} than {bound}."


def _refusals(design: DesignSection) -> list[Block]:
    """Why candidates were left out, most refusals first."""
    refused = sorted(design.refused.items(), key=lambda item: -item[1])
    if not refused:
        return []
    reason, count = refused[0]
    candidates, reason = text.count(count, "candidate"), text.replace_symbols(reason)
    if len(refused) == 1:
        verb = "was" if count == 1 else "were"
        return [
            Paragraph(
                f"{candidates} {verb} left out before the choice, because they {reason}."
            )
        ]
    columns = [
        TableColumn("Candidates", number=True),
        TableColumn("which …", wide=True),
    ]
    rows = [[str(n), text.replace_symbols(why)] for why, n in refused]
    caption = (
        "Candidates left out before the choice; one may have several reasons. Most,"
        f" {count}, {reason}."
    )
    return [Table(columns, rows, caption)]


# Predicted accuracy of each component, plan by plan, as marks on a log scale.

MAX_COMPONENTS: Final = 8


def draw_predicted(plans: Sequence[PlanScore]) -> style.Figure:
    """A line for each component, a mark for each plan; lengths and angles apart."""
    shown = [plan for plan in plans if plan.predicted][:MAX_COMPONENTS]
    if not shown:
        return style.empty(
            "No predicted accuracy of the plans is stored in this result."
        )
    groups: dict[str, list[str]] = {}
    for key in shown_components(shown):
        groups.setdefault(text.split_unit(key)[1], []).append(key)
    labels = [style.label(plan.name, 40) for plan in shown]
    columns = style.legend_columns(labels)
    rows = max(map(len, groups.values()))
    legend_rows = math.ceil(len(labels) / columns)
    figure = style.figure(0.75 + 0.27 * rows + 0.17 * legend_rows)
    panels = figure.subplots(1, len(groups), squeeze=False)[0]
    for axes, (unit, keys) in zip(panels, groups.items(), strict=True):
        _error_panel(axes, keys, shown, labels)
        of_unit = f" [{text.unit_symbol(unit)}]" if unit else ""
        axes.set_xlabel(f"predicted rms error{of_unit}")
    handles, names = panels[0].get_legend_handles_labels()
    legend: Any = {"loc": "outside lower center", "ncols": columns}
    figure.legend(handles[::-1], names[::-1], **legend)
    return figure


def shown_components(plans: Sequence[PlanScore]) -> list[str]:
    """Components that any of the plans predicts, in order of appearance."""
    return list(dict.fromkeys(key for plan in plans for key in plan.predicted))


def _error_panel(
    axes: style.Axes,
    keys: Sequence[str],
    plans: Sequence[PlanScore],
    labels: Sequence[str],
) -> None:
    tables = [plan.predicted for plan in plans]
    rms = np.column_stack([missing.column(tables, key) for key in keys])
    rms[~(rms > 0.0)] = np.nan
    rows = np.arange(len(keys))
    finite = np.isfinite(rms).any(axis=0)
    least = np.nanmin(rms[:, finite], axis=0)
    most = np.nanmax(rms[:, finite], axis=0)
    axes.hlines(rows[finite], least, most, color=style.LIGHT, lw=1.0)
    # The chosen plan is the first: drawn last, it lies on top.
    for k in reversed(range(len(plans))):
        look: Any = {"color": style.CYCLE[k % len(style.CYCLE)], "ls": ""}
        look |= {"marker": style.marker(k), "ms": 6 if k == 0 else 5}
        look |= {"mec": "white", "mew": 0.4, "zorder": 4.0 - 0.1 * k}
        axes.plot(rms[k], rows, label=labels[k], **look)
    if finite.any():
        axes.set_xlim(float(least.min()) / 1.35, 1.35 * float(most.max()))
    style.log_axis(axes, "x")
    stems = [text.split_unit(key)[0] for key in keys]
    style.fixed_ticks(axes, "y", rows.tolist(), stems)
    axes.set_ylim(len(keys) - 0.5, -0.5)


def plan_blocks(design: DesignSection) -> list[Block]:
    """Scores, then predicted accuracy as figure and table."""
    plans = design.plans
    if not plans:
        return []
    content: list[Block] = [_scores(design)]
    if any(plan.predicted for plan in plans):
        caption = _figure_caption(plans)
        content.append(Picture("predicted", lambda: draw_predicted(plans), caption))
        content.append(_accuracies(design))
    return content


# The chosen plan against reference plans: by the criterion, and by accuracy.
def is_chosen(plan: PlanScore, design: DesignSection) -> bool:
    """Whether a plan is the chosen one, by its name or by all its numbers."""
    if plan.name == "chosen":
        return True
    of_plan = (plan.n, plan.value, plan.kappa)
    return of_plan == (design.n, design.value, design.kappa)


def _marks(design: DesignSection) -> list[str]:
    return ["chosen" if is_chosen(plan, design) else "" for plan in design.plans]


# -- by the criterion ------------------------------------------------------------------
def _scores(design: DesignSection) -> Table:
    plans = design.plans
    criterion = plans[0].criterion
    indices = list(dict.fromkeys(key for plan in plans for key in plan.observability))
    columns = {
        "Readings": [str(plan.n) for plan in plans],
        criterion: [criterion_value(criterion, plan.value) for plan in plans],
        "log det": [text.fixed(plan.logdet, 2) for plan in plans],
        f"{criterion}-efficiency": [text.percent(plan.efficiency) for plan in plans],
    }
    if criterion == "D":  # its value is the column log det
        del columns["D"]
    if criterion != "kappa":
        columns["κ"] = [text.number(plan.kappa, 4) for plan in plans]
    for index in indices:
        if index != criterion:
            values = missing.column([plan.observability for plan in plans], index)
            columns[index] = [text.number(value) for value in values]
    titles = [TableColumn("Plan", wide=True), *TableColumn.numbers(*columns)]
    cells = [[plan.name for plan in plans], *columns.values()]
    return Table(titles, transposed(cells), _scores_caption(design), _marks(design))


def _scores_caption(design: DesignSection) -> str:
    """The chosen plan against the best of the others."""
    caption = (
        "The chosen plan (marked) and reference plans. Higher log det and lower κ are"
        " better."
    )
    if design.effects is not None:
        caption += " All are judged on a machine without effects."
    plans = [plan for plan in design.plans if plan.efficiency > 0.0]
    chosen = [plan for plan in plans if is_chosen(plan, design)]
    others = [plan for plan in plans if not is_chosen(plan, design)]
    if not chosen or not others:
        return caption
    rival = max(others, key=lambda plan: plan.efficiency)
    share = rival.efficiency / chosen[0].efficiency
    if share > 1.0:
        return f"{caption} The plan “{rival.name}” is better than the chosen one."
    caption += (
        f" The next best, “{rival.name}”, has {text.percent(share)} of the efficiency of"
        " the chosen one"
    )
    if rival.criterion != "D" or rival.n != chosen[0].n:
        return f"{caption}."
    # D-efficiency grows in proportion to the number of readings.
    more = math.ceil(rival.n / share - rival.n)
    return f"{caption}: it needs about {text.count(more, 'more reading')} to match it."


# -- by predicted accuracy -------------------------------------------------------------
def _figure_caption(plans: Sequence[PlanScore]) -> str:
    """What the chosen plan leaves of each component."""
    sentences = [
        "Predicted rms error of each component over the workspace after all known"
        " errors are corrected, on a log scale.",
        "Each plan has a mark; left is better.",
    ]
    first = plans[0]
    errors = [_error(key, rms) for key, rms in first.predicted.items()]
    if errors:
        sentences.append(f"The plan “{first.name}” leaves {text.listing(errors)}.")
    with_prediction = [plan for plan in plans if plan.predicted]
    more = len(with_prediction) - MAX_COMPONENTS
    if more > 0:
        sentences.append(f"{more} more are in the table only.")
    return " ".join(sentences)


def _error(key: str, rms: float) -> str:
    stem, unit = text.split_unit(key)
    return f"{stem} {text.quantity(rms, unit)}"


def _accuracies(design: DesignSection) -> Table:
    """Two rows for each plan: rms errors, and the gain over the reference plan."""
    keys = shown_components(design.plans)
    has_gains = any(plan.gain for plan in design.plans)
    reference = design.plans[1] if len(design.plans) > 1 and has_gains else None
    rows, marks = [], []
    for plan, mark in zip(design.plans, _marks(design), strict=True):
        errors = [text.number(missing.entry(plan.predicted, key)) for key in keys]
        rows.append([plan.name, *errors])
        marks.append(mark)
        if reference is not None and plan is not reference and plan.gain:
            gains = [text.times(missing.entry(plan.gain, key)) for key in keys]
            rows.append(["… times as accurate", *gains])
            marks.append(mark)
    titles = [text.heading(key) for key in keys]
    columns = [TableColumn("Plan", wide=True), *TableColumn.numbers(*titles)]
    caption = _accuracies_caption(design.plans[0], reference)
    return Table(columns, rows, caption, marks)


def _accuracies_caption(chosen: PlanScore, reference: PlanScore | None) -> str:
    caption = "Predicted rms errors, plan by plan"
    if reference is None:
        return f"{caption}."
    caption += f", and how many times as accurate as with “{reference.name}”."
    if not chosen.gain:
        return caption
    least = text.times(min(chosen.gain.values()))
    most = text.times(max(chosen.gain.values()))
    gain = least if least == most else f"{least} to {most}"
    return f"{caption} The chosen plan is {gain} as accurate."
