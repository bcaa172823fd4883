"""Chapter: least squares with tolerance priors: the fit, its parameters, its residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.fit_limits import ALARM_PROBABILITY, MIN_DOF, chi2_is_large
from oed.result import (
    CombinationEstimate,
    EstimateSection,
    GoodnessSection,
    NoiseRecord,
    ParameterEstimate,
    RunCurve,
    StudyResult,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Notice,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections.answer import fits_with_effects
from pkm_reports.sections.measure import is_plan

# Part of the chapter on the fit: chi-square, and the noise law as estimated.

MAX_RUNS: Final = 8  #: runs that the table shows
#: probability below which a sum of squares is not what the noise predicts
MIN_P_VALUE: Final = 0.01
MEANING: Final = {
    "reading": "Scatter of single readings",
    "run": "Error that a run shares",
    "seat": "Set-up seated anew for a run",
    "course": "Drift through the session",
    "carried": "Correlated share of the variance",
    "reach": "Length of the correlation",
}


def goodness_blocks(checked: GoodnessSection) -> str:
    """Chi-square against the stated noise, with the probability of either tail."""
    chi2, dof = text.number(checked.chi2), text.number(checked.dof)
    high, low = or_nan(checked.p_high), or_nan(checked.p_low)
    chance = (
        f"a larger value has probability {_probability(high)}, a smaller one"
        f" {_probability(low)}"
    )
    verdict = goodness_judgement(
        or_nan(checked.dof),
        is_large=high < MIN_P_VALUE,
        is_small=low < ALARM_PROBABILITY,
    )
    if high < MIN_P_VALUE <= (checked.law_p_high or 0.0):
        verdict = "more than the stated noise leaves at these parameters"
    return (
        f"χ² is {chi2} for {dof} degrees of freedom{checked.chi2_words} by the stated"
        f" noise ({chance}): {verdict}.{_law_judgement(checked)}"
    )


def _law_judgement(checked: GoodnessSection) -> str:
    """How the same readings agree with the estimated law; empty without one."""
    if checked.law_p_high is None:
        return ""
    return (
        " By the noise law as estimated, with a scatter within a factor 1.5 of the"
        f" stated one, a larger misfit has probability {_probability(checked.law_p_high)}."
    )


def goodness_judgement(dof: float, *, is_large: bool, is_small: bool = False) -> str:
    """Whether chi-square agrees with the stated noise, where any freedom judges it."""
    if not dof >= MIN_DOF:
        return (
            "no machine within its tolerances gives these readings"
            if is_large
            else "the readings leave no freedom to judge the noise by"
        )
    if is_large:
        return (
            "more than the stated noise explains: the model lacks something, or the"
            " noise is larger"
        )
    if is_small:
        return "less than the stated noise would leave: the noise is overstated"
    return "as the stated noise predicts"


def _probability(p: float) -> str:
    return "below 10⁻⁹" if p < 1e-9 else text.number(p, 2)


def noise_blocks(checked: GoodnessSection | None) -> list[Block]:
    """The noise law as a table, and how it departs; nothing where it is as stated."""
    if checked is None or not checked.noise:
        return []
    columns = [
        TableColumn("Noise"),
        TableColumn("Of"),
        *TableColumn.numbers("Estimate", "sd", "Stated"),
        TableColumn("Unit"),
    ]
    rows = [_left_out_row(record) for record in checked.noise.values()]
    marks = ["chosen" if r.departs else "" for r in checked.noise.values()]
    caption = (
        "The noise law as estimated from the readings. Fit and intervals are means over"
        " all laws that the readings allow."
    )
    departures: list[Block] = [Notice(text.sentence(w)) for w in checked.noise_words]
    return [*departures, Table(columns, rows, caption, marks)]


def left_out(checked: GoodnessSection | None) -> list[Block]:
    """Runs as predicted from all others, the worst first; nothing for a single run."""
    if checked is None or not checked.left_out:
        return []
    columns = [
        TableColumn("Set-up"),
        TableColumn("Run"),
        *TableColumn.numbers("Values", "Errors / predicted", "p", "Log score"),
    ]
    worst = sorted(checked.left_out, key=lambda run: run.p_high)[:MAX_RUNS]
    rows = [
        [
            run.setup,
            run.run,
            str(run.values),
            text.number(run.ratio, 2),
            _probability(run.p_high),
            text.fixed(run.log_score, 1),
        ]
        for run in worst
    ]
    score = text.fixed(checked.left_out_score, 1)
    sd = text.fixed(checked.left_out_sd, 1)
    count = text.count(len(checked.left_out), "run")
    caption = (
        f"Each of {count} predicted from all others, the most surprising first. Their"
        f" log score, which compares models of the same readings, is {score} ± {sd}."
    )
    return [Table(columns, rows, caption)]


def _left_out_row(record: NoiseRecord) -> list[str]:
    decimals = text.decimals_for(record.sd)
    return [
        text.meaning(record.kind, MEANING),
        record.of,
        text.fixed(record.value, decimals),
        text.fixed(record.sd, decimals),
        text.MISSING if record.stated is None else text.trimmed(record.stated),
        text.unit_symbol(record.unit),
    ]


# Residuals of all readings, before and after the fit.

MANY_READINGS: Final = 60  #: readings from which marks are small


def draw_residuals(estimate: EstimateSection) -> style.Figure:
    """Before and after side by side, a row for each unit, each panel with its scale."""
    before, after = estimate.residuals_before, estimate.residuals
    panels = [
        ("Nominal machine", missing.array(before), style.GREY),
        ("Identified machine", missing.array(after), style.BLUE),
    ]
    panels = [panel for panel in panels if np.isfinite(panel[1]).any()]
    if not panels:
        return style.empty("No residuals are stored in this result.")
    unit_of_each = np.array([estimate.units[name] for name in estimate.channels])
    units = list(dict.fromkeys(unit_of_each.tolist()))
    figure = style.figure(2.4 * len(units))
    grid = figure.subplots(len(units), len(panels), squeeze=False)
    for row, unit in zip(grid, units, strict=True):
        label = f"residual [{text.unit_symbol(unit)}]"
        for axes, (title, values, colour) in zip(row, panels, strict=True):
            _panel(axes, title, values[unit_of_each == unit], colour)
            axes.set(xlabel="reading, in the order of the data", ylabel=label)
    return figure


def _panel(axes: style.Axes, title: str, values: Array, colour: str) -> None:
    number = np.arange(1, len(values) + 1)
    axes.vlines(number, 0.0, values, color=colour, lw=0.7, alpha=0.6)
    axes.plot(
        number,
        values,
        "o",
        ms=2.6 if len(number) > MANY_READINGS else 3.6,
        color=colour,
    )
    axes.axhline(0.0, color=style.INK, lw=0.7)
    rms = np.sqrt(np.nanmean(values**2))
    axes.set_title(f"{title}: rms {text.number(rms)}")
    style.few_ticks(axes.xaxis, 6, integer=True)
    largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    axes.set_ylim(-1.15 * largest, 1.15 * largest)


# Identified parameters against their tolerances: value, interval, improvement.

TYPE_COLOURS: Final = {"seen": style.BLUE, "weak": style.ORANGE, "prior": style.GREY}
#: what `identified` of a parameter means
TYPE_MEANINGS: Final = {
    "seen": "determined",
    "weak": "weakly determined",
    "prior": "tolerance only",
}
HALF_WIDTH_95: Final = 1.96  #: half-width of a 95 % interval, in standard deviations


def draw_parameters(parameters: Mapping[str, ParameterEstimate]) -> style.Figure:
    """Intervals (95 %) in tolerances on the left, sd over tolerance on the right."""
    rows = {name: p for name, p in parameters.items() if p.prior_sd > 0.0}
    if not rows:
        return style.empty("No parameter with a tolerance is stored in this result.")
    figure = style.figure(0.9 + 0.155 * max(len(rows), 4))
    deviations, ratios = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for k, estimate in enumerate(rows.values()):
        _interval(deviations, ratios, k, estimate)
    _set_axes(deviations, ratios, list(rows), [shrinkage(p) for p in rows.values()])
    style.legend_below(figure, style.legend_entries([deviations]), 5)
    return figure


def shrinkage(estimate: ParameterEstimate) -> float:
    """Standard deviation after the readings over that before them."""
    return estimate.sd / estimate.prior_sd if estimate.prior_sd > 0.0 else math.nan


def _interval(
    deviations: style.Axes, ratios: style.Axes, k: int, estimate: ParameterEstimate
) -> None:
    deviation = (estimate.value - estimate.nominal) / estimate.prior_sd
    truth = (or_nan(estimate.truth) - estimate.nominal) / estimate.prior_sd
    sd = shrinkage(estimate)
    verdict = estimate.identified
    colour = TYPE_COLOURS.get(verdict, style.BLUE)
    half = HALF_WIDTH_95 * sd
    bar: Any = {"color": colour, "lw": 2.2, "solid_capstyle": "butt"}
    deviations.plot([deviation - half, deviation + half], [k, k], **bar)
    label = text.meaning(verdict, TYPE_MEANINGS)
    deviations.plot(deviation, k, "o", color=colour, ms=3.5, label=label)
    if math.isfinite(truth):
        cross: Any = {"color": style.INK, "ms": 5, "mew": 1.1, "zorder": 4}
        deviations.plot(truth, k, "x", label="truth (virtual machine)", **cross)
    ratios.plot(sd, k, "o", color=colour, ms=4)


def _set_axes(
    deviations: style.Axes,
    ratios: style.Axes,
    names: Sequence[str],
    shrinkages: Sequence[float],
) -> None:
    deviations.axvspan(
        -1.0, 1.0, color=style.SHADE, lw=0, zorder=0, label="± 1 tolerance"
    )
    deviations.set(xlabel="deviation from nominal [tolerances], 95 % interval")
    ratios.axvline(1.0, color=style.GREY, ls="--", lw=0.9)
    smallest = min([0.08, *[0.6 * sd for sd in shrinkages if sd > 0.0]])
    ratios.set_xlim(smallest, 1.6 * max([1.0, *shrinkages]))
    style.log_axis(ratios, "x")
    ratios.set(xlabel="sd after / tolerance")
    style.fixed_ticks(deviations, "y", range(len(names)), names)
    deviations.set_ylim(len(names) - 0.4, -0.6)
    ratios.tick_params(axis="y", labelleft=False)


Estimates = Mapping[str, ParameterEstimate]
MARKS: Final = {"weak": "chosen", "prior": "bad"}
MAX_TERMS: Final = 5  #: terms of a combination that are written


def blocks(result: StudyResult) -> list[Block]:
    """Fit, residuals, parameters as table and figure, iterations."""
    estimate = result.estimate
    if estimate is None:
        return []
    caption = _residuals_caption(estimate)
    chapter: list[Block] = [
        Paragraph(_fit(estimate, result.goodness)),
        *_warnings(result, estimate),
        Picture("residuals", lambda: draw_residuals(estimate), caption),
        *_runs(estimate),
        *noise_blocks(result.goodness),
        *left_out(result.goodness),
    ]
    values = estimate.parameters
    if values:
        # The table breaks over pages; before it, the tall picture would leave a gap.
        caption = _parameters_caption(values)
        picture = Picture("parameters", lambda: draw_parameters(values), caption)
        chapter += [_table(values), picture]
    chapter += _combinations(estimate.combinations)
    return chapter


def _warnings(result: StudyResult, estimate: EstimateSection) -> list[Block]:
    """Those of a fit that is not delivered; those of others stand on the first page."""
    if not fits_with_effects(result):
        return []
    heading = "Of this fit, which has no effects in its model:"
    return headed_list(heading, text.sentences(estimate.warnings))


def printed(result: StudyResult) -> list[Block]:
    """The parameters of a machine that was measured."""
    estimate = result.estimate
    if estimate is None or is_plan(result) or not estimate.parameters:
        return []
    if result.gap is not None and result.gap.mixture is not None:
        return []  # those over all hypotheses are delivered
    return [_table(estimate.parameters)]


def _fit(estimate: EstimateSection, checked: GoodnessSection | None) -> str:
    aside = "" if checked is None else checked.fit_words
    sentences = [f"The fit uses {text.count(estimate.readings, 'reading')}{aside}."]
    before, after = estimate.rms_before, estimate.rms_after
    changes = [
        f"from {_rms_of(estimate, name, before)} to {_rms_of(estimate, name, after)}"
        f" ({name})"
        for name in before
    ]
    if changes:
        falls = all(missing.entry(after, name) < before[name] for name in before)
        verb = "falls" if falls else "changes"
        sentences.append(f"The rms residual {verb} {text.listing(changes)}.")
    if checked is not None and checked.chi2 is not None:
        return " ".join([*sentences, goodness_blocks(checked)])
    chi2, dof = text.number(estimate.chi2), text.number(estimate.dof)
    judgement = goodness_judgement(
        estimate.dof, is_large=chi2_is_large(estimate.chi2, estimate.dof)
    )
    sentences.append(f"χ² is {chi2} for {dof} degrees of freedom: {judgement}.")
    return " ".join(sentences)


def _rms_of(estimate: EstimateSection, channel: str, rms: Mapping[str, float]) -> str:
    return text.channel_value(channel, missing.entry(rms, channel), estimate.units)


def _residuals_caption(estimate: EstimateSection) -> str:
    caption = (
        "Residual of each reading with nominal and with identified parameters, on"
        " different scales."
    )
    sizes = np.abs(missing.array(estimate.residuals))
    several_units = len(set(estimate.units.values())) > 1
    if several_units or not np.isfinite(sizes).any():
        return caption
    worst = int(np.nanargmax(sizes))
    unit = estimate.units[estimate.channels[worst]]
    largest = text.quantity(sizes[worst], unit)
    return f"{caption} The largest after the fit is {largest}, at reading {worst + 1}."


def _runs(estimate: EstimateSection) -> list[Block]:
    """Readings along circles and lines, before and after compensation."""
    curves = estimate.runs
    if not curves:
        return []
    caption = curves_caption(curves)
    return [Picture("run_curves", lambda: draw_run_curves(curves), caption)]


def _parameters_caption(values: Estimates) -> str:
    """How many parameters are determined, and how many intervals hold the truth."""
    verdicts = [estimate.identified for estimate in values.values()]
    determined, weak = verdicts.count("seen"), verdicts.count("weak")
    sentences = [
        "Each parameter against its tolerance.",
        f"{determined} of {len(verdicts)} are determined, {weak} only weakly,"
        f" {verdicts.count('prior')} stay as uncertain as the tolerance.",
    ]
    shrinkages = {name: shrinkage(p) for name, p in values.items()}
    finite = {name: x for name, x in shrinkages.items() if math.isfinite(x)}
    if finite:
        best = min(finite, key=lambda name: finite[name])
        share = text.percent(finite[best])
        sentences.append(f"Most improved: {best}, to {share} of its tolerance.")
    pulls = [pull for pull in map(_pull, values.values()) if math.isfinite(pull)]
    if pulls:
        inside = sum(abs(pull) <= HALF_WIDTH_95 for pull in pulls)
        expected = round(0.95 * len(pulls))
        sentences.append(
            f"{inside} of {len(pulls)} intervals contain the truth (crosses); about"
            f" {expected} should."
        )
    return " ".join(sentences)


def _pull(estimate: ParameterEstimate) -> float:
    """(value - truth) / sd."""
    if not estimate.sd > 0.0:
        return math.nan
    return (estimate.value - or_nan(estimate.truth)) / estimate.sd


def _table(values: Estimates) -> Table:
    columns = [
        TableColumn("Parameter"),
        *TableColumn.numbers("Value", "sd", "Nominal", "Tolerance"),
        TableColumn("Unit"),
        TableColumn("Verdict"),
    ]
    caption = (
        "Identified parameters with standard deviations; nominal value and tolerance are"
        " mean and standard deviation before any reading."
    )
    with_truth = any(estimate.truth is not None for estimate in values.values())
    if with_truth:
        columns += TableColumn.numbers("Truth", "Pull")
        caption += " Pull: (value − truth) / sd."
    rows = [_row(name, p, with_truth=with_truth) for name, p in values.items()]
    marks = [MARKS.get(estimate.identified, "") for estimate in values.values()]
    return Table(columns, rows, caption, marks)


def _row(name: str, estimate: ParameterEstimate, *, with_truth: bool) -> list[str]:
    decimals = text.decimals_for(estimate.sd)
    cells = [
        name,
        text.fixed(estimate.value, decimals),
        text.fixed(estimate.sd, decimals),
        text.trimmed(estimate.nominal, 7),
        text.trimmed(estimate.prior_sd, 3),
        text.unit_symbol(estimate.unit),
        text.meaning(estimate.identified, TYPE_MEANINGS),
    ]
    if with_truth:
        cells.append(text.fixed(estimate.truth, decimals))
        cells.append(text.fixed(_pull(estimate), 1))
    return cells


def _combinations(combinations: Sequence[CombinationEstimate]) -> list[Block]:
    """Combinations of several parameters; single ones are in the table before."""
    several = [one for one in combinations if len(one.terms) > 1]
    if not several:
        return []
    columns = [
        TableColumn("Combination", wide=True),
        *TableColumn.numbers("Value", "sd", "Tolerance"),
        TableColumn("Unit"),
    ]
    rows = []
    for one in several:
        decimals = text.decimals_for(one.sd)
        cells = [text.fixed(one.value, decimals), text.fixed(one.sd, decimals)]
        name = text.linear_combination(one.terms, MAX_TERMS)
        tolerance = text.trimmed(one.tolerance, 3)
        rows.append([name, *cells, tolerance, text.unit_symbol(one.unit)])
    caption = (
        "Combinations whose parameters the readings do not determine one by one:"
        " departure from nominal."
    )
    return [Table(columns, rows, caption)]


CHAPTER: Final = Chapter("identification", "Identification", blocks, printed)

# Readings along circles and lines: measured, predicted with interval, compensated.

MAX_CURVES: Final = 4  #: runs that are drawn
MAX_LARGE: Final = 60  #: readings of a run up to which marks are of full size
AXIS_LABELS: Final = {"circle": "angle [°]", "line": "distance along the line [mm]"}
INTERVAL: Final = "95 % interval"


def draw_run_curves(curves: Sequence[RunCurve], *, after: bool = False) -> style.Figure:
    """A row a run: from nominal, from the prediction, `after` compensation."""
    sizes = [_largest(missing.array(curve.measured)) for curve in curves]
    ranked = sorted(range(len(curves)), key=lambda k: -sizes[k])
    shown = [curves[k] for k in sorted(ranked[:MAX_CURVES])]
    if not shown:
        return style.empty("No readings along runs are stored in this result.")
    columns = 3 if any(curve.compensated for curve in shown) else 2
    figure = style.figure(0.6 + 1.6 * len(shown))
    grid = figure.subplots(len(shown), columns, squeeze=False)
    moment = "after" if after else "before"
    titles = [
        f"{moment.capitalize()} compensation",
        "Measured − predicted",
        "After compensation",
    ]
    for axes, title in zip(grid[0], titles, strict=False):
        axes.set_title(title)
    for row, curve in zip(grid, shown, strict=True):
        _curve_row(row, curve)
    style.legend_below(figure, style.legend_entries(grid[:, :2].ravel()), 3)
    return figure


def _largest(values: Array) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0))


def _curve_row(row: Sequence[style.Axes], curve: RunCurve) -> None:
    along = missing.array(curve.at)
    measured, predicted = missing.array(curve.measured), missing.array(curve.predicted)
    half = missing.array(curve.half_widths)
    _draw_predicted(row[0], along, predicted, half)
    _draw_measured(row[0], along, measured)
    _draw_band(row[1], along, np.zeros(len(along)), half)
    _draw_measured(row[1], along, measured - predicted)
    if curve.compensated:
        remaining = missing.array(curve.compensated)
        half_after = missing.array(curve.compensated_half_widths)
        _draw_predicted(row[2], along, remaining, half_after)
    elif len(row) > 2:
        style.hide(row[2:])
    for axes in row:
        axes.axhline(0.0, color=style.INK, lw=0.6)
        style.few_ticks(axes.yaxis, 4)
        axes.set_xlabel(AXIS_LABELS[curve.kind])
        if curve.kind == "circle":
            axes.set_xlim(0.0, 360.0)
            style.ticks_every(axes.xaxis, 90.0)
    name = style.label(f"{curve.setup}, {curve.run}", 24)
    row[0].set_ylabel(f"{name}\n{curve.channel} [{text.unit_symbol(curve.unit)}]")


def _draw_measured(axes: style.Axes, along: Array, values: Array) -> None:
    look: Any = {"ls": "", "marker": "o", "color": style.BLUE}
    axes.plot(
        along,
        values,
        ms=2.6 if len(along) <= MAX_LARGE else 1.4,
        label="measured",
        **look,
    )


def _draw_predicted(axes: style.Axes, along: Array, values: Array, half: Array) -> None:
    _draw_band(axes, along, values, half)
    axes.plot(along, values, color=style.ORANGE, lw=1.1, label="predicted")


def _draw_band(axes: style.Axes, along: Array, values: Array, half: Array) -> None:
    look: Any = {"color": style.LIGHT, "lw": 0.0, "label": INTERVAL}
    axes.fill_between(along, values - half, values + half, **look)


def curves_caption(curves: Sequence[RunCurve]) -> str:
    """What the figure shows, and the largest difference from the prediction."""
    inside, count = curve_coverage(curves)
    difference, unit = largest_difference(curves)
    sentences = [
        "Readings along circles and lines, as departures from those of the nominal"
        " machine.",
        f"{inside} of {count} lie inside their 95 % interval (parameters and noise); the"
        f" largest difference from the prediction is {text.quantity(difference, unit)}.",
    ]
    if any(curve.compensated for curve in curves):
        sentences.append(
            "After compensation the instrument still reads what no drive corrects and the"
            " errors of its set-up; a place that the machine teaches is taught anew."
        )
    more = len(curves) - MAX_CURVES
    if more > 0:
        sentences.append(f"{more} more are in result.json.")
    return " ".join(sentences)


def curve_coverage(curves: Sequence[RunCurve]) -> tuple[int, int]:
    """Number of readings inside their interval, and of all."""
    inside = count = 0
    for curve in curves:
        error = np.abs(_difference(curve))
        inside += int((error <= missing.array(curve.half_widths)).sum())
        count += len(error)
    return inside, count


def largest_difference(curves: Sequence[RunCurve]) -> tuple[float, str]:
    """Largest measured less predicted reading, of those in the unit of the first."""
    unit = curves[0].unit
    sizes = [_largest(_difference(c)) for c in curves if c.unit == unit]
    return max(sizes, default=math.nan), unit


def _difference(curve: RunCurve) -> Array:
    return missing.array(curve.measured) - missing.array(curve.predicted)
