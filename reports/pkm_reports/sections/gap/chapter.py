"""Chapter: the gap between model and machine: its causes, its places, its remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from oed import units
from oed.result import (
    ClosureRecord,
    CoefficientRecord,
    GapSection,
    PlaceRecord,
    StudyResult,
    Trace,
)
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Items,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
    number_columns,
    wide_column,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections.figures.gap import effects
from pkm_reports.sections.figures.gap import map as gap_map
from pkm_reports.sections.figures.gap import polar as gap_polar
from pkm_reports.sections.figures.gap import trace as gap_trace
from pkm_reports.sections.figures.gap.effects import spoken
from pkm_reports.sections.gap import explanations


def blocks(result: StudyResult) -> list[Block]:
    """Findings, remedy, causes, places, closure, residuals, what remains open."""
    gap = result.gap
    if gap is None:
        return []
    return [
        Items(text.sentences(gap.words), numbered=True),
        _causes(gap),
        *explanations.blocks(gap),
        *_places(gap),
        *_closure(gap),
        *_residuals(gap),
        *_pictures(gap),
        *_open_questions(gap),
        *_coefficients(gap),
    ]


def printed(result: StudyResult) -> list[Block]:
    """Causes, explanations, places and closure."""
    gap = result.gap
    if gap is None:
        return []
    return [
        _causes(gap),
        *explanations.answers(gap),
        *_places(gap),
        *_closure(gap),
    ]


def _causes(gap: GapSection) -> Picture:
    caption = explanations.probabilities_caption(gap)
    return Picture("gap_causes", lambda: effects.draw(gap), caption)


def _residuals(gap: GapSection) -> list[Block]:
    """The rms residual before and after, and what the noise is."""
    sentences = text.sentences(gap.noise)
    if gap.rms_before:
        sentences = [_rms(gap), *sentences]
    return [Paragraph(" ".join(sentences))] if sentences else []


def _rms(gap: GapSection) -> str:
    before, after = gap.rms_before, gap.rms_after
    if before == after:
        sizes = [f"{_rms_of(gap, n, before)} ({n})" for n in before]
        return f"The rms residual of all readings is {text.listing(sizes)}."
    changes = [
        f"from {_rms_of(gap, name, before)} to {_rms_of(gap, name, after)} ({name})"
        for name in before
    ]
    falls = all(missing.entry(after, name) <= rms for name, rms in before.items())
    verb = "falls" if falls else "changes"
    return f"The rms residual of all readings {verb} {text.listing(changes)}."


def _rms_of(gap: GapSection, channel: str, rms: Mapping[str, float]) -> str:
    return text.channel_value(channel, missing.entry(rms, channel), gap.units)


CHAPTER: Final = Chapter("gap", "The gap: causes, place, remedy", blocks, printed)


# -- where the gap lies: legs, set-ups, runs, times, directions ------------------------


MOST_PLACES: Final = 8
#: probability of an even share below which a place stands out
SIGNIFICANT: Final = 0.05


def _places(gap: GapSection) -> list[Block]:
    """Places with their share of the gap."""
    places = gap.where[:MOST_PLACES]
    if not places or not gap.effect_reported:
        return []
    columns = [
        wide_column("Where"),
        *number_columns("Share of the gap", "Not more than its share"),
    ]
    rows = [
        [_place(p), text.percent(p.strength), text.number(p.p_value, 2)] for p in places
    ]
    caption = (
        "Where the gap lies, first the place that confines it best. The share is the"
        " posterior mean of the part of the gap's energy, as calibration leaves it, that"
        " lies there; of a stretch of time, or a direction, as it acts. A time is a place"
        " only of what varies with time, a set-up of what belongs to set-ups; directions"
        " are compared at the same poses. The last column is the probability that the place"
        " holds no more of the gap than of the readings, or of the legs: a small one singles"
        " the place out. One gap lies in several places at once."
    )
    marks = ["chosen" if record.p_value < SIGNIFICANT else "" for record in places]
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
HIGHEST: Final = 1.0
#: a gap of which no more than the noise is left
ALL: Final = "all of it"
#: share from which percent are rounded down, never up to the whole
NEARLY_WHOLE: Final = 0.99


def _closure(gap: GapSection) -> list[Block]:
    """One row for each way of holding readings out; none where no effect is reported."""
    if not gap.closure or not gap.effect_reported:
        return []
    columns = [
        wide_column("Held out"),
        *number_columns("Readings", "Gap closed", "95 % interval", "Chance of harm"),
        *number_columns("Before", "After", "Noise alone"),
    ]
    rows = [
        [
            text.meaning(closure.split, SPLITS),
            str(closure.n),
            _closed(closure.value),
            _interval(closure),
            text.percent(closure.p_worse),
            text.number(closure.s0),
            text.number(closure.s1),
            text.number(closure.s_noise),
        ]
        for closure in gap.closure
    ]
    caption = (
        "How far what calibration leaves shrinks, beyond the noise and in its mean"
        " square, on readings that were held out of the fit. Before,"
        " after and noise alone are mean squared residuals in units of their expected"
        " value; the gap closed is (before − after) / (before − noise alone), all of it"
        " where no more than the noise is left. Whole"
        " held-out runs also show what the geometry cannot learn from the other runs."
    )
    return [Table(columns, rows, caption)]


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
    if value > HIGHEST:
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
        Picture("gap_trace", lambda: gap_trace.draw(traces), caption)
    ]
    if gap_polar.circles(traces):
        caption = _polar_caption(traces)
        content.append(Picture("gap_polar", lambda: gap_polar.draw(traces), caption))
    if spots:
        caption = _map_caption(gap)
        unit = gap.spots_unit
        content.append(Picture("gap_map", lambda: gap_map.draw(spots, unit), caption))
    return content


def _trace_caption(traces: Sequence[Trace]) -> str:
    colours = ["grey after calibration"]
    if gap_polar.explains(traces):
        colours += [
            "orange the part that the effects found explain",
            "blue the residual with these effects in the model",
        ]
    if any(value != 0.0 for trace in traces for value in trace.unexplained):
        colours.append("pink a part of a form that no known effect has")
    single_channel = len({trace.channel for trace in traces}) == 1
    noun = "run" if single_channel else "trace"
    shown, runs = len(gap_trace.choose(traces)), text.count(len(traces), noun)
    extent = f"{runs}."
    if shown < len(traces):
        extent = f"Shown are the {shown} of {runs} with the largest residuals before."
    return f"Residual of each run: {', '.join(colours)}. {extent}"


def _polar_caption(traces: Sequence[Trace]) -> str:
    caption = "Circles as a ball bar draws them"
    if gap_polar.explains(traces):
        caption += (
            ", above before and below after the effects found are in the model. The"
            " residual is magnified about the thin circle, equally above and below"
        )
    else:
        caption += ". The residual is magnified about the thin circle"
    caption += "; the bar in the centre gives its scale."
    circles = {gap_polar.circle_key(t) for t in traces if t.kind == "circle"}
    shown = len(gap_polar.circles(traces))
    if shown < len(circles):
        return (
            f"{caption} Shown are the {shown} of {len(circles)} circles with the largest"
            " residuals."
        )
    return f"{caption} {text.count(len(circles), 'circle')}."


def _map_caption(gap: GapSection) -> str:
    caption = "Residual by place of the tool"
    if gap_polar.explains(gap.traces):
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
        wide_column("Why not"),
        wide_column("Record in the readings"),
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


MOST_COEFFICIENTS: Final = 12


def _coefficients(gap: GapSection) -> list[Block]:
    """The largest coefficients in expected sizes, first the largest."""
    ranked = sorted(
        gap.coefficients, key=lambda c: -abs(expected_sizes_text(c, c.value))
    )
    shown = ranked[:MOST_COEFFICIENTS]
    if not shown:
        return []
    columns = [
        TableColumn("Effect"),
        wide_column("Coefficient"),
        *number_columns("Value", "Sd", "In expected sizes"),
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
