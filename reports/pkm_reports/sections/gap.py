"""Chapter: the gap between model and machine: its causes, its places, its remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from oed import units
from oed.base import Array
from oed.result import (
    AnswerRecord,
    ClosureRecord,
    CoefficientRecord,
    CompensationName,
    GapSection,
    MixtureSection,
    PlaceRecord,
    PredictionSection,
    Spot,
    StudyResult,
    Trace,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Items,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections import gap_figures
from pkm_reports.sections.accuracy import spread_figures
from pkm_reports.sections.gap_figures import size_in_readings, spoken

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

# Circles as a ball bar shows them: residuals magnified about the circle.

MAX_CIRCLES: Final = 3
SWING = 0.45  #: largest residual as a share of the drawn radius
OUTER = 1.6  #: outer radius over the drawn one
#: label, line and colour of a direction of travel
DIRECTIONS: Final = {1: ("forward", "-", style.BLUE), -1: ("backward", "--", style.RED)}
NO_DIRECTION: Final = ("direction unknown", "-", style.GREY)
QUARTERS: Final = np.radians([0.0, 90.0, 180.0, 270.0]).tolist()
#: set-up, name without its pass, channel, payload (N) of a circle
CircleKey = tuple[str, str, str, float | None]
When = Literal["before", "after"]  #: before or after the effects are in the model


def draw_circles(traces: Sequence[Trace]) -> Figure:
    """A column for each circle: above before, below after, where effects were found."""
    drawn = gap_circles(traces)
    if not drawn:
        return style.empty("No run of these readings is a circle.")
    rows: list[When] = ["before", "after"] if explains(traces) else ["before"]
    width = min(style.FIGURE_WIDTH, 2.25 * len(drawn) + 0.4)
    figure = style.figure(0.5 + 2.3 * len(rows), width=width)
    polar: Any = {"projection": "polar"}
    shape = (len(rows), len(drawn))
    grid: Any = figure.subplots(*shape, squeeze=False, subplot_kw=polar)
    for column, (key, runs) in zip(grid.T, drawn.items(), strict=True):
        largest = max(gap_figures.largest_size(run.before) for run in runs) or 1.0
        unit = text.unit_symbol(runs[0].unit)
        for axes, when in zip(column, rows, strict=True):
            _circle_panel(axes, runs, when, largest)
            name = when if len(rows) > 1 else "residual"
            title = f"{name}: rms {text.number(_circle_rms(runs, when), 2)} {unit}"
            if when == "before":
                title = f"{style.label(_circle_name(key), 26)}\n{title}"
            letters: Any = {"fontsize": 7, "fontweight": "normal"}
            axes.set_title(title, loc="center", pad=8, **letters)
        _ruler(column[-1], largest, unit)
    entries = style.legend_entries(grid.ravel())
    style.legend_below(figure, entries, len(entries))
    return figure


def gap_circles(traces: Sequence[Trace]) -> dict[CircleKey, list[Trace]]:
    """The circles with the largest residuals, with all passes, in the order of the data."""
    passes: dict[CircleKey, list[Trace]] = {}
    for trace in traces:
        if trace.kind == "circle":
            passes.setdefault(circle_key(trace), []).append(trace)
    ranked = sorted(passes, key=lambda key: -_circle_rms(passes[key], "before"))[
        :MAX_CIRCLES
    ]
    return {key: runs for key, runs in passes.items() if key in ranked}


def circle_key(trace: Trace) -> CircleKey:
    """What the passes of one circle have in common."""
    return trace.setup, trace.base, trace.channel, trace.payload


def explains(traces: Sequence[Trace]) -> bool:
    """Whether the effects of the diagnosis explain any residual."""
    return any(value != 0.0 for trace in traces for value in trace.explained)


def _circle_name(key: CircleKey) -> str:
    setup, base, _, payload = key
    load = "" if payload is None else f", {text.trimmed(payload, 3)} N"
    return f"{setup}, {base}{load}"


def _circle_residuals(trace: Trace, when: When) -> Array:
    return missing.array(trace.before if when == "before" else trace.after)


def _circle_rms(runs: Sequence[Trace], when: When) -> float:
    squares = [gap_figures.rms(_circle_residuals(run, when)) ** 2 for run in runs]
    return float(np.sqrt(np.mean(squares)))


def _circle_panel(axes: Any, runs: Sequence[Trace], when: When, largest: float) -> None:
    around = np.linspace(0.0, 2.0 * math.pi, 181)
    axes.plot(around, np.ones_like(around), color=style.INK, lw=0.6)
    for run in runs:
        angle = np.radians(missing.array(run.at))
        residuals = _circle_residuals(run, when)
        order = np.arange(len(angle))
        if _goes_round(angle):
            order = np.append(order, 0)
        radius = np.clip(1.0 + SWING * residuals[order] / largest, 0.05, OUTER)
        label, line, colour = DIRECTIONS.get(run.direction or 0, NO_DIRECTION)
        look: Any = {"color": colour, "lw": 0.9, "marker": "o", "ms": 1.4}
        axes.plot(angle[order], radius, line, label=label, **look)
    axes.set_rlim(0.0, OUTER)
    style.ticks_at(axes.yaxis, [1.0 - SWING, 1.0, 1.0 + SWING])
    axes.set_yticklabels([])
    style.ticks_at(axes.xaxis, QUARTERS)
    axes.set_xticklabels(["0°", "90°", "180°", "270°"], fontsize=6)
    axes.tick_params(axis="x", pad=-3)
    axes.spines["polar"].set_visible(False)


def _goes_round(angle: Array) -> bool:
    again = np.min(angle) + 2.0 * math.pi
    steps = np.diff([*np.sort(angle), again])
    return bool(steps.max() < 4.0 * np.median(steps) + 1e-9)


def _ruler(axes: Any, largest: float, unit: str) -> None:
    """A bar in the middle of the circle, and the residual that it stands for."""
    size = _round_size(largest)
    bar: Any = {"color": style.INK, "lw": 1.8, "solid_capstyle": "butt"}
    axes.plot([0.0, 0.0], [0.0, SWING * size / largest], **bar)
    letters: Any = {"ha": "center", "va": "center", "fontsize": 6.5}
    axes.text(math.pi * 0.75, 0.16, f"{text.trimmed(size, 2)} {unit}", **letters)


def _round_size(largest: float) -> float:
    """1, 2 or 5 times a power of ten, at most `largest`."""
    power = 10.0 ** math.floor(math.log10(largest))
    sizes = [k * power for k in (1.0, 2.0, 5.0)]
    return max(size for size in sizes if size <= largest * (1.0 + 1e-9))


# Residuals over the workspace, before and after the effects are in the model.

View = tuple[int, int]  #: two axes of the base frame to look along: across and up
#: extent of an axis, as a share of the largest, from which it has a view of its own
MIN_EXTENT: Final = 0.05
AXES: Final = ("x", "y", "z")
#: inches of a row: for a square view, and limits
ROW_HEIGHT, MIN_ROW, MAX_ROW = 2.5, 1.2, 2.6
TOP_QUANTILE: Final = 0.98  #: quantile of the residuals that ends the colour scale


def draw_map(spots: Sequence[Spot], unit: str) -> Figure:
    """Places coloured by rms residual: a row a view, before and, if it differs, after."""
    from matplotlib.colors import Normalize

    if not spots:
        return style.empty("No places are stored in this result.")
    places = missing.table([spot.at for spot in spots])
    columns = _columns(spots)
    pairs = map_views(places)
    heights = [_row_height(places, pair) for pair in pairs]
    width = style.FIGURE_WIDTH if len(columns) > 1 else 0.6 * style.FIGURE_WIDTH
    figure = style.figure(0.5 + sum(heights), width=width)
    shape = (len(pairs), len(columns))
    grid = figure.subplots(*shape, squeeze=False, height_ratios=heights)
    before = columns[0][1]
    top = float(np.nanquantile(before, TOP_QUANTILE)) or 1.0
    norm = Normalize(0.0, top)
    for row, pair in zip(grid, pairs, strict=True):
        for axes, (_, values) in zip(row, columns, strict=True):
            image = _panel(axes, places, pair, values, norm)
    for axes, (name, values) in zip(grid[0], columns, strict=True):
        rms = text.number(np.sqrt(np.nanmean(values**2)), 3)
        axes.set_title(f"{name}: rms {rms}", fontsize=8)
    beyond = float(np.nanmax(before)) > 1.001 * top
    bar_look: Any = {"shrink": 0.8, "pad": 0.02}
    bar_look["extend"] = "max" if beyond else "neither"
    panels = grid.ravel().tolist()
    bar: Any = figure.colorbar(image, ax=panels, label=_scale_label(unit), **bar_look)
    bar.outline.set_visible(False)
    style.few_ticks(bar.ax.yaxis, 5)
    return figure


def _columns(spots: Sequence[Spot]) -> list[tuple[str, Array]]:
    """Title and residual of each place (n,): before and after, or one of both."""
    before = missing.array([spot.before for spot in spots])
    after = missing.array([spot.after for spot in spots])
    if np.array_equal(before, after, equal_nan=True):
        return [("residual", before)]
    return [("before", before), ("after", after)]


def _scale_label(unit: str) -> str:
    if unit == "sigma":
        return "residual [times the stated noise]"
    return f"rms residual [{text.unit_symbol(unit)}]"


def map_views(places: Array) -> list[View]:
    """Pairs of axes to look along; two where the places (n, 3) fill the space."""
    spread = np.ptp(places, axis=0)
    order = [int(k) for k in np.argsort(-spread, kind="stable")]
    if spread[order[2]] > MIN_EXTENT * spread[order[0]]:
        return [(0, 1), (0 if spread[0] >= spread[1] else 1, 2)]
    across, up = sorted(order[:2])
    return [(across, up)]


def _row_height(places: Array, view: View) -> float:
    """Inches of a row, so that lengths are alike both ways, within reason."""
    across, up = (max(float(np.ptp(places[:, k])), 1e-9) for k in view)
    return float(np.clip(ROW_HEIGHT * up / across, MIN_ROW, MAX_ROW)) + 0.35


def _panel(
    axes: Axes, places: Array, view: View, values: Array, norm: Normalize
) -> Any:
    order = np.argsort(values)  # large residuals on top
    across, up = places[order, view[0]], places[order, view[1]]
    look: Any = {"cmap": style.AMOUNT, "norm": norm, "ec": style.GREY, "lw": 0.3}
    look["s"] = float(np.clip(3000.0 / len(places), 6.0, 30.0))
    image = axes.scatter(across, up, c=values[order], **look)
    axes.set(xlabel=f"{AXES[view[0]]} [mm]", ylabel=f"{AXES[view[1]]} [mm]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    style.few_ticks(axes.xaxis, 4)
    style.few_ticks(axes.yaxis, 4)
    return image


# Chapter: the gap between model and machine: its causes, its places, its remedy.
def blocks(result: StudyResult) -> list[Block]:
    """Findings, remedy, causes, places, closure, residuals, what remains open."""
    gap = result.gap
    if gap is None:
        return []
    return [
        Items(text.sentences(gap.words), numbered=True),
        _causes(gap),
        *explanation_blocks(gap),
        *_places(gap),
        *_closure(gap),
        *_pictures(gap),
        *_open_questions(gap),
        *_coefficients(gap),
    ]


def printed(result: StudyResult) -> list[Block]:
    """Causes, explanations, places and closure."""
    gap = result.gap
    if gap is None:
        return []
    return [_causes(gap), *answers(gap), *_places(gap), *_closure(gap)]


def _causes(gap: GapSection) -> Picture:
    caption = probabilities_caption(gap)
    return Picture("gap_causes", lambda: gap_figures.draw_effects(gap), caption)


CHAPTER: Final = Chapter("gap", "Diagnosis: causes, location, remedy", blocks, printed)

# -- where the gap lies: legs, set-ups, runs, times, directions ------------------------
MAX_PLACES: Final = 8
P_VALUE: Final = 0.05  #: probability of an even share below which a place stands out


def _places(gap: GapSection) -> list[Block]:
    places = gap.where[:MAX_PLACES]
    if not places or not gap.effect_reported:
        return []
    columns = [
        TableColumn("Where", wide=True),
        *TableColumn.numbers("Share of the residual error", "p"),
    ]
    rows = [
        [_place(p), text.percent(p.strength), text.number(p.p_value, 2)] for p in places
    ]
    caption = (
        "Where the residual error lies: the smallest part that holds most of it comes first."
        " p: probability that the part holds no more than an even share; a small p singles"
        " it out. The parts overlap."
    )
    marks = ["chosen" if record.p_value < P_VALUE else "" for record in places]
    return [Table(columns, rows, caption, marks)]


def _place(record: PlaceRecord) -> str:
    """A place, and the one of another kind that has the same readings."""
    name = _name(record.block)
    return f"{name} (the same as {_name(record.same_as)})" if record.same_as else name


def _name(block: str) -> str:
    kind, _, where = block.partition(" ")
    if kind == "time":
        return f"time {where} s"
    if kind == "phase":
        return f"part of each run, {where}°"
    return block


# -- how far the gap closes on held-out readings ---------------------------------------
SPLITS: Final = {"within": "stretches of runs", "whole": "whole runs"}
#: share beyond which an end of an interval is not written in figures
MAX_SHARE: Final = 1.0
ALL: Final = "all of it"  #: a gap of which no more than the noise is left
#: share from which percent are rounded down, never up to the whole
NEARLY_WHOLE: Final = 0.99


def _closure(gap: GapSection) -> list[Block]:
    """One row for each way of holding readings out; none where no effect is reported."""
    closures = [closure for closure in gap.closure if closure.value is not None]
    if not closures or not gap.effect_reported:
        return []
    columns = [
        TableColumn("Held out", wide=True),
        *TableColumn.numbers(
            "Readings", "Removed", "95 % interval", "Probability of harm"
        ),
        *TableColumn.numbers("Before", "After", "Noise alone"),
    ]
    rows = [
        [
            text.meaning(closure.split, SPLITS),
            str(closure.n),
            _closed(closure.value),
            _interval(closure),
            text.MISSING
            if closure.p_worse is None
            else _drawn_probability(closure.p_worse),
            text.number(closure.s0),
            text.number(closure.s1),
            text.number(closure.s_noise),
        ]
        for closure in closures
    ]
    caption = (
        "What the effects remove of the mean squared residual beyond the noise, on readings"
        " that were held out of the fit. Before, After and Noise alone: mean squared"
        " residuals over their expected value. Removed: (before − after) / (before − noise"
        " alone). Whole held-out runs also test what the geometry learns from other runs."
    )
    return [Table(columns, rows, caption)]


def _drawn_probability(probability: float) -> str:
    """A probability by draws, of which a few hundred exclude no more than 1 %."""
    return text.percent(probability) if probability >= 0.01 else "under 1 %"


def _closed(value: float | None) -> str:
    """The share that is closed; beyond the whole, less than the noise expects is left."""
    if or_nan(value) >= 1.0:
        return ALL
    return text.MISSING if value is None else _end(value)


def _interval(closure: ClosureRecord) -> str:
    if closure.low is None or closure.high is None:
        return text.MISSING
    return f"{_end(closure.low)} to {_end(closure.high)}"


def _end(value: float) -> str:
    """An end of an interval; far off what a share can be, it says no more than that."""
    if value > MAX_SHARE:
        return f"over 100{text.NO_BREAK}%"
    if value < ClosureRecord.MIN_STATED:
        return f"under {text.MINUS}100{text.NO_BREAK}%"
    return _share(value)


def _share(value: float | None) -> str:
    """A share in percent, never rounded up to the whole."""
    nearly_whole = NEARLY_WHOLE < or_nan(value) < 1.0
    return text.percent_at_least(value) if nearly_whole else text.percent(value)


# -- residuals as figures --------------------------------------------------------------
def _pictures(gap: GapSection) -> list[Block]:
    """Traces, circles where there are any, map."""
    traces, spots = gap.traces, gap.spots
    if not traces:
        return []
    caption = _trace_caption(traces)
    content: list[Block] = [
        Picture("gap_trace", lambda: gap_figures.draw_traces(traces), caption)
    ]
    if gap_circles(traces):
        caption = _polar_caption(traces)
        content.append(Picture("gap_polar", lambda: draw_circles(traces), caption))
    if spots:
        caption = _map_caption(gap)
        unit = gap.spots_unit
        content.append(Picture("gap_map", lambda: draw_map(spots, unit), caption))
    return content


def _trace_caption(traces: Sequence[Trace]) -> str:
    colours = ["grey after calibration"]
    if explains(traces):
        colours += [
            "orange the part that the effects found explain",
            "blue the residual with these effects in the model",
        ]
    if any(value != 0.0 for trace in traces for value in trace.unexplained):
        colours.append("pink a part of a form that no known effect has")
    single_channel = len({trace.channel for trace in traces}) == 1
    noun = "run" if single_channel else "trace"
    shown, runs = len(gap_figures.choose_traces(traces)), text.count(len(traces), noun)
    extent = f"{runs}."
    if shown < len(traces):
        extent = f"Shown are the {shown} of {runs} with the largest residuals before."
    return f"Residual of each run: {', '.join(colours)}. {extent}"


def _polar_caption(traces: Sequence[Trace]) -> str:
    caption = "Circles as a ball bar draws them"
    if explains(traces):
        caption += (
            ", above before and below after the effects found are in the model. The"
            " residual is magnified about the thin circle, equally above and below"
        )
    else:
        caption += ". The residual is magnified about the thin circle"
    caption += "; the bar in the centre gives its scale."
    circles = {circle_key(t) for t in traces if t.kind == "circle"}
    shown = len(gap_circles(traces))
    if shown < len(circles):
        return (
            f"{caption} Shown are the {shown} of {len(circles)} circles with the largest"
            " residuals."
        )
    return f"{caption} {text.count(len(circles), 'circle')}."


def _map_caption(gap: GapSection) -> str:
    caption = "Residual by place of the tool"
    if explains(gap.traces):
        caption += (
            ", before and after the effects found are in the model, with one scale"
        )
    places = text.count(len(gap.spots), "place")
    return f"{caption}. {places}; readings at one place are taken together."


# -- effects that look alike, effects that were not tested -----------------------------
def _open_questions(gap: GapSection) -> list[Block]:
    """Groups of effects that cannot be distinguished, then untested effects."""
    groups = [_group(gap, names) for names in gap.confusable if len(names) > 1]
    heading = "These readings cannot tell the effects of a group from one another:"
    return [*headed_list(heading, groups), *_untested(gap)]


def _group(gap: GapSection, names: Sequence[str]) -> str:
    notes = [gap.about[name] for name in names if name in gap.about]
    ways = dict.fromkeys(note.exposed_by for note in notes if note.exposed_by)
    group = text.listing(spoken(name) for name in names)
    if ways:
        group += f"; what tells them apart: {'; '.join(ways)}"
    return text.sentence(group)


def _untested(gap: GapSection) -> list[Block]:
    if not gap.not_testable:
        return []
    columns = [
        TableColumn("Effect"),
        TableColumn("Why not", wide=True),
        TableColumn("Record in the readings", wide=True),
    ]
    rows = []
    for name in gap.not_testable:
        reason, column = "", ""
        if name in gap.about:
            reason, column = gap.about[name].missing, gap.about[name].column
        rows.append([spoken(name), reason, column or text.MISSING])
    caption = (
        "Effects that these readings cannot test. Where a column is missing, they may"
        " act all the same."
    )
    return [Table(columns, rows, caption)]


# -- coefficients against the sizes expected of them -----------------------------------
MAX_COEFFICIENTS: Final = 12


def _coefficients(gap: GapSection) -> list[Block]:
    """The largest coefficients in expected sizes, first the largest."""
    ranked = sorted(
        gap.coefficients, key=lambda c: -abs(expected_sizes_text(c, c.value))
    )
    shown = ranked[:MAX_COEFFICIENTS]
    if not shown:
        return []
    columns = [
        TableColumn("Effect"),
        TableColumn("Coefficient", wide=True),
        *TableColumn.numbers("Value", "Sd", "In expected sizes"),
    ]
    caption = (
        "Coefficients of the effects found, and in units of the size that was expected"
        " of each"
    )
    if len(ranked) > len(shown):
        caption += f"; the {len(shown)} largest of {len(ranked)}"
    return [Table(columns, [_coefficient_row(c) for c in shown], f"{caption}.")]


def _coefficient_row(coefficient: CoefficientRecord) -> list[str]:
    value = expected_sizes_text(coefficient, coefficient.value)
    sd = expected_sizes_text(coefficient, coefficient.sd)
    expected = f"{text.fixed(value, 2)} ± {text.fixed(sd, 2)}"
    unit, factor = units.coefficient_unit(coefficient.unit)
    return [
        spoken(coefficient.effect),
        f"{coefficient.name} [{text.unit_symbol(unit)}]",
        text.number(coefficient.value / factor),
        text.number(coefficient.sd / factor, 2),
        text.MISSING if math.isnan(value) else expected,
    ]


def expected_sizes_text(coefficient: CoefficientRecord, number: float) -> float:
    """A value or sd over the expected size; NaN where that is not known."""
    size = coefficient.prior_sd
    return math.nan if size is None or not size > 0.0 else number / size


# Explanations of the gap with their probabilities, and the sizes of the effects.

MAX_ANSWERS: Final = 6
#: members from which a class is counted, not represented by one of its names
MAX_NAMED: Final = 6
#: what the probability of one effect is of
MARGINALS: Final = (
    "Only sizes that these readings can show count. Effects that look alike share their"
    " probability."
)


def explanation_blocks(gap: GapSection) -> list[Block]:
    """Explanations, the credible set, sizes of the effects."""
    content = answers(gap)
    if gap.answers and len(gap.set95) > 1:
        caption = (
            "Credible set: with 95 % probability one of these sets of effects acts, with or"
            " without a remainder of unknown form. The remainder is named where it is more"
            " likely than not. An effect stands for all that cannot be distinguished from"
            " it."
        )
        content.append(_explanations(gap.set95, caption))
    if gap.sizes:
        content.append(_size_table(gap))
    return content


def answers(gap: GapSection) -> list[Block]:
    """The explanations with their probabilities."""
    if not gap.answers:
        return []
    caption = (
        "Explanations of the residual error. Beside a named effect, one that could be any"
        " of many counts as an effect of unknown form. " + _decision()
    )
    return [_explanations(gap.answers[:MAX_ANSWERS], caption)]


def probabilities_caption(gap: GapSection) -> str:
    """How many effects could be tested, and which are not shown."""
    sentences = [
        "Probability that each effect acts in these readings, after calibration"
        f" explained what it can. {MARGINALS}",
        f"{len(gap.tried) - len(gap.not_testable)} of"
        f" {text.count(len(gap.tried), 'effect')} could be tested.",
    ]
    classes = gap.answers[0].classes if gap.answers else []
    if any(len(group) > 1 for group in classes):
        sentences.append(
            "Those in light blue cannot be distinguished from those in blue."
        )
    more = len(gap.marginal) - len(gap_figures.shown_effects(gap))
    if more > 0:
        sentences.append(f"The {more} least probable are not shown.")
    return " ".join(sentences)


def _explanations(explained: Sequence[AnswerRecord], caption: str) -> Table:
    columns = [
        TableColumn("Explanation", wide=True),
        TableColumn("Probability", number=True),
        TableColumn("Cannot be distinguished from", wide=True),
    ]
    return Table(columns, [explanation_row(answer) for answer in explained], caption)


def _decision() -> str:
    """When no effect is reported."""
    sure = text.percent(GapSection.NO_GAP_PROBABILITY)
    return (
        "No effect is reported where noise alone, or effects too small for these readings"
        f" to show, have a probability of {sure} or more. An effect less likely than noise"
        " alone is a reason to read again; nothing is corrected for it."
    )


def explanation_row(answer: AnswerRecord) -> list[str]:
    """An explanation, its probability, and what cannot be distinguished from it."""
    aliases = [
        spoken(name)
        for group in answer.classes
        for name in group
        if name not in answer.effects or len(group) >= MAX_NAMED
    ]
    others = text.listing(dict.fromkeys(aliases)) or text.MISSING
    return [_explanation(answer), text.percent(answer.probability), others]


def _explanation(answer: AnswerRecord) -> str:
    """The effects of an answer; one of a large class is not named before the others."""
    if answer.unseen >= answer.probability > 0.0:
        return "an effect too small for these readings to show"
    sizes = {
        group[0]: len(group) for group in answer.classes if len(group) >= MAX_NAMED
    }
    names = [_effect_name(name, sizes) for name in answer.effects]
    return text.listing(names) or "no effect: noise alone"


def _effect_name(name: str, class_sizes: Mapping[str, int]) -> str:
    if name == "unknown":
        return "an effect of unknown form"
    if name in class_sizes:
        return f"one of {class_sizes[name]}"
    return spoken(name)


def _size_table(gap: GapSection) -> Table:
    columns = [
        TableColumn("Effect"),
        TableColumn("What it is", wide=True),
        *TableColumn.numbers("Size, rms", "After calibration, rms", "Detectability"),
    ]
    rows = [
        [
            spoken(size.effect),
            _effect_text(gap, size.effect),
            size_in_readings(gap, size.rms),
            size_in_readings(gap, size.remaining) or text.MISSING,
            text.number(size.detectability),
        ]
        for size in gap.sizes
    ]
    caption = (
        "Effects found: how large each is in the readings, and what calibration without"
        " it leaves of that. Detectability: the same as a multiple of the noise over all"
        " readings together; below about 5 an effect is hard to detect."
    )
    if any(_effect_constants(gap, size.effect) for size in gap.sizes):
        caption += (
            " In brackets: what its form depends on, at the likeliest value, in SI"
            " units."
        )
    return Table(columns, rows, caption)


def _effect_text(gap: GapSection, effect: str) -> str:
    """What an effect is, with the constants of its form in SI."""
    about = gap.about[effect].about if effect in gap.about else ""
    constants = _effect_constants(gap, effect)
    if not constants:
        return about
    values = [f"{name} = {text.number(value)}" for name, value in constants.items()]
    return f"{about} ({', '.join(values)})"


def _effect_constants(gap: GapSection, effect: str) -> Mapping[str, float]:
    return gap.constants.get(effect, {})


# Chapter: parameters and accuracy over all hypotheses of a diagnosis.

#: compensations that a controller can be sent, as a reader knows them
COMPENSATIONS: Final = {
    CompensationName.MIXTURE: "Geometry, over all hypotheses",
    CompensationName.BEST: "Geometry, best hypothesis alone",
    CompensationName.PLAIN: "Geometry, fit without effects",
    CompensationName.BEST_WITH_EFFECTS: "Best answer with its effects corrected",
    CompensationName.NOTHING: "Nothing corrected",
}


def mixture_blocks(result: StudyResult) -> list[Block]:
    """Answers, expected errors of each compensation, parameters with their intervals."""
    section = None if result.gap is None else result.gap.mixture
    if section is None:
        return []
    chapter: list[Block] = [Paragraph(" ".join(text.sentences(section.words)))]
    if section.prediction is not None:
        chapter.append(_compensation_choices(section, section.prediction))
        chapter += _mixture_accuracy(section)
    chapter.append(_mixture_parameters(section))
    return chapter


def mixture_printed(result: StudyResult) -> list[Block]:
    """The parameters that are delivered."""
    section = None if result.gap is None else result.gap.mixture
    return [] if section is None else [_mixture_parameters(section)]


def _compensation_choices(
    section: MixtureSection, prediction: PredictionSection
) -> Table:
    names = list(prediction.components)
    units = [text.unit_symbol(prediction.unit[name]) for name in names]
    heads = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    rows = [
        [COMPENSATIONS[choice.name], *(text.number(choice.rms[n]) for n in names)]
        for choice in section.choices
    ]
    caption = (
        "Rms error over the workspace that is expected after each compensation, as the"
        " mean over the hypotheses by their probabilities."
    )
    return Table(
        [TableColumn("Compensation"), *TableColumn.numbers(*heads)], rows, caption
    )


def _mixture_accuracy(section: MixtureSection) -> list[Block]:
    """Figures with intervals of what is sent: geometry, and with effects if any."""
    tables: list[Block] = []
    for name, prediction in (
        (section.sent or CompensationName.MIXTURE, section.prediction),
        (CompensationName.BEST_WITH_EFFECTS, section.with_effects),
    ):
        if prediction is None:
            continue
        columns = [TableColumn("Component")]
        columns += TableColumn.numbers("rms", "p95", "max", "rms of 95 % of machines")
        rows = []
        for component, accuracy in prediction.components.items():
            unit = text.unit_symbol(accuracy.after.unit)
            rows.append(
                [
                    f"{component} [{unit}]",
                    *spread_figures(accuracy.after),
                    _interval_text(accuracy.after.rms_interval),
                ]
            )
        about = COMPENSATIONS[name].lower()
        caption = f"Predicted errors with this compensation: {about}."
        tables.append(Table(columns, rows, caption))
    return tables


def _interval_text(ends: Sequence[float] | None) -> str:
    if ends is None:
        return ""
    low, high = (text.number(end, 2) for end in ends)
    return f"{low} to {high}"


#: standard deviation over the value below which a parameter is fixed but for rounding
FIXED_SD: Final = 1e-12


def _mixture_parameters(section: MixtureSection) -> Table:
    columns = [
        TableColumn("Parameter"),
        *TableColumn.numbers("Value", "sd", "Within hypotheses", "95 % interval"),
        *TableColumn.numbers("For the controller"),
    ]
    rows = []
    free = {
        n: p for n, p in section.parameters.items() if p.sd > FIXED_SD * abs(p.value)
    }
    for name, p in free.items():
        decimals = text.decimals_for(p.sd)
        sent = section.controller.get(name)
        rows.append(
            [
                f"{name} [{text.unit_symbol(p.unit)}]",
                text.fixed(p.value, decimals),
                text.number(p.sd, 2),
                text.number(p.within, 2),
                f"{text.fixed(p.low, decimals)} to {text.fixed(p.high, decimals)}",
                "" if sent is None else text.fixed(sent, decimals),
            ]
        )
    caption = (
        "Parameters over all hypotheses. Within hypotheses: standard deviation if the cause"
        " were known; what the sd has beyond it comes from not knowing the cause. A"
        " controller that corrects the geometry alone takes the last column, which has the"
        " least expected error."
    )
    return Table(columns, rows, caption)


MIXTURE_CHAPTER: Final = Chapter(
    "mixture", "Over all hypotheses", mixture_blocks, mixture_printed
)
