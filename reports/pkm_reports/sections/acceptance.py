"""Chapter: the acceptance test, and whether the machine passed it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.result import (
    AcceptanceSection,
    HeldOutSection,
    PromiseRecord,
    RunCurve,
    StudyResult,
    VerdictRecord,
    VerificationSection,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
)
from pkm_reports.sections import identification


def blocks(result: StudyResult) -> list[Block]:
    """What is demanded, at which poses, and the verdict where there are readings."""
    acceptance, verification = result.acceptance, result.verification
    chapter = _runs(result.after_compensation)
    if acceptance is None:
        return chapter
    if verification is not None:
        chapter += _verdict(verification)
    chapter.append(Paragraph(_introduction(acceptance)))
    chapter += headed_list("The promise rests on:", acceptance.conditions)
    chapter.append(_demands(acceptance.components))
    if acceptance.further:
        chapter.append(_demands(acceptance.further, further=True))
    chapter.append(_poses(acceptance))
    return chapter


def printed(result: StudyResult) -> list[Block]:
    """Verdict, demands and poses."""
    if result.acceptance is None:
        return []
    test = result.verification
    verdict_blocks = [] if test is None else _verdict(test)
    demands = _demands(result.acceptance.components)
    return [*verdict_blocks, demands, _poses(result.acceptance)]


def _runs(curves: Sequence[RunCurve]) -> list[Block]:
    """Readings along circles and lines of the compensated machine."""
    if not curves:
        return []
    caption = identification.curves_caption(curves)
    picture = Picture(
        "runs_after",
        lambda: identification.draw_run_curves(curves, after=True),
        caption,
    )
    return [picture]


def verdict(verification: VerificationSection) -> str:
    """The judgement in a sentence."""
    judged = {**verification.components, **verification.further}
    if verification.judgement == "pass":
        return "The acceptance test is passed: the measured errors confirm the promise."
    names = [n for n, c in judged.items() if c.judgement == verification.judgement]
    if verification.judgement == "fail":
        return (
            f"The acceptance test is failed: {text.listing(names)} exceeds its limit."
        )
    return (
        f"The acceptance test cannot tell whether {text.listing(names)} meets the promise:"
        " measure more accurately, or at more poses."
    )


def _introduction(acceptance: AcceptanceSection) -> str:
    miss = text.percent(acceptance.miss - 1.0)
    return (
        f"{text.count(len(acceptance.poses), 'pose')} that the calibration did not read"
        " confirm the promised rms errors. Power: probability that a machine whose"
        f" errors are {miss} larger than promised fails. A machine just at its promise"
        f" fails with probability {text.percent(acceptance.false_alarm)}."
    )


def _demands(promises: Mapping[str, PromiseRecord], *, further: bool = False) -> Table:
    """What is demanded of each component; `further` ones have additional axes or not."""
    first = ("Without", "With: promised") if further else ("Promised rms",)
    titles = (*first, "Meets to", "Fails above", "Uncertainty", "Power")
    rows = []
    for name, d in promises.items():
        without = ["" if d.without is None else text.number(d.without)]
        rows.append(
            [
                f"{name} [{text.unit_symbol(d.unit)}]",
                *(without if further else []),
                text.number(d.promised),
                text.MISSING if d.confirms is None else text.number(d.confirms),
                text.number(d.limit),
                text.number(d.uncertainty, 2),
                text.fixed(d.power, 2),
            ]
        )
    caption = (
        "Demands on the rms of the errors measured at the poses below. Between the two"
        " limits the test cannot tell; without a lower one its power is too small to"
        " confirm. Uncertainty: of one measured error, one standard deviation."
    )
    if further:
        caption = (
            "What no drive corrects, as rms errors without additional axes, and with axes"
            " that take the known error back (columns with “offset” of the compensation"
            " table)."
        )
    return Table(
        [TableColumn("Component"), *TableColumn.numbers(*titles)], rows, caption
    )


def _poses(acceptance: AcceptanceSection) -> Table:
    titles = [text.heading(name) for name in acceptance.poses[0]]
    rows = [[text.trimmed(v, 6) for v in pose.values()] for pose in acceptance.poses]
    return Table(TableColumn.numbers(*titles), rows, "Poses to measure.")


def _verdict(verification: VerificationSection) -> list[Block]:
    caption = f"Measured errors against their limits. {verdict(verification)}"
    titles: tuple[str, ...] = ("Measured rms", "Limit", "Largest")
    blocks: list[Block] = [_judged(verification.components, titles, caption)]
    if verification.further:
        titles = ("Without: rms", "With: rms", "Limit", "Largest")
        caption = (
            "What no drive corrects: measured errors without additional axes, and with"
            " axes that take the known error back."
        )
        blocks.append(_judged(verification.further, titles, caption))
    if verification.positioning:
        blocks.append(_positioning(verification))
    return blocks


def _judged(
    components: Mapping[str, VerdictRecord], titles: Sequence[str], caption: str
) -> Table:
    """Measured errors and verdicts; with four titles those without axes before."""
    rows = []
    for name, c in components.items():
        sizes = [text.number(v) for v in (c.rms, c.limit, c.max)]
        without = "" if c.without is None else text.number(c.without)
        cells = [without, *sizes][-len(titles) :]
        title = f"{name} [{text.unit_symbol(c.unit)}]"
        rows.append([title, *cells, text.VERDICTS[c.judgement]])
    columns = [TableColumn("Component"), *TableColumn.numbers(*titles)]
    marks = [text.MARKS[c.judgement] for c in components.values()]
    return Table([*columns, TableColumn("Verdict")], rows, caption, marks)


def _positioning(verification: VerificationSection) -> Table:
    columns = [
        TableColumn("Component"),
        *TableColumn.numbers("Targets", "Approaches", "A", "E", "R", "M", "B"),
    ]
    rows = []
    for name, p in verification.positioning.items():
        figures = [p.accuracy, p.systematic, p.repeatability, p.mean, p.reversal]
        cells = ["" if v is None else text.number(v) for v in figures]
        unit = text.unit_symbol(p.unit)
        rows.append([f"{name} [{unit}]", str(p.targets), str(p.approaches), *cells])
    caption = (
        "Figures in the manner of ISO 230-2 over the acceptance poses: accuracy A,"
        " systematic deviation E, repeatability R, mean bidirectional deviation M,"
        " reversal B. The standard asks for five approaches a direction along one axis."
    )
    return Table(columns, rows, caption)


CHAPTER: Final = Chapter("acceptance", "Acceptance test", blocks, printed)


# Residuals of held-out readings, with their predictive intervals.
def draw_residuals(sets: Sequence[HeldOutSection]) -> style.Figure:
    """Measured minus predicted, each with its 95 % interval as a bar around zero."""
    shown = [entry for entry in sets if entry.residuals]
    if not shown:
        return style.empty("No held-out residuals are stored in this result.")
    figure = style.figure(0.5 + 1.75 * len(shown))
    panels = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
    for axes, entry in zip(panels, shown, strict=True):
        _residual_panel(axes, entry)
    style.legend_below(figure, style.legend_entries(figure.axes[:1]), 3)
    return figure


def _residual_panel(axes: style.Axes, entry: HeldOutSection) -> None:
    residuals = missing.array(entry.residuals)
    half = np.resize(missing.array(entry.half_widths or [None]), len(residuals))
    number = np.arange(1, len(residuals) + 1)
    inside = ~(np.abs(residuals) > half)
    bars: Any = {"color": style.LIGHT, "lw": min(7.0, 200.0 / len(number))}
    axes.vlines(number, -half, half, label="95 % predictive interval", **bars)
    axes.plot(number[inside], residuals[inside], "o", color=style.BLUE, label="inside")
    cross: Any = {"color": style.RED, "ms": 5, "label": "outside"}
    axes.plot(number[~inside], residuals[~inside], "X", **cross)
    axes.axhline(0.0, color=style.INK, lw=0.7)
    style.few_ticks(axes.xaxis, 12, integer=True)
    axes.set_title(style.label(f"{entry.name}: {entry.channel}", 70))
    unit = text.unit_symbol(entry.unit)
    axes.set(xlabel="reading", ylabel=f"residual [{unit}]")


# Chapter: readings held out of the fit, and how well the fit predicts them.

MIN_COVERAGE: Final = 0.85
CAPTION: Final = (
    "Prediction of held-out readings. A new set-up has unknowns of its own (an offset, a"
    " scale). The first rms adjusts them to its readings; the second leaves them at"
    " their nominal values."
)


def held_out_blocks(result: StudyResult) -> list[Block]:
    """Residuals with predictive intervals, and a table of rms and coverage."""
    sets = result.held_out
    if not sets:
        return []
    picture = Picture("held_out", lambda: draw_residuals(sets), _residual_caption(sets))
    return [picture, _coverage_table(sets)]


def _residual_caption(sets: Sequence[HeldOutSection]) -> str:
    inside = [
        f"{text.percent(entry.coverage)} of {entry.n} in {_set_name(entry)}"
        for entry in sets
    ]
    caption = (
        "Measured minus predicted, for readings that the fit did not use. Inside their"
        f" 95 % interval: {text.listing(inside)}."
    )
    narrow = [_set_name(entry) for entry in sets if not _is_covered(entry)]
    if narrow:
        return (
            f"{caption} That is too few in {text.listing(narrow)}: the stated"
            " uncertainty is too small there."
        )
    return f"{caption} That agrees with the stated uncertainty."


def _set_name(entry: HeldOutSection) -> str:
    return f"{entry.name} ({entry.channel})"


def _is_covered(entry: HeldOutSection) -> bool:
    return entry.coverage >= MIN_COVERAGE


def _coverage_table(sets: Sequence[HeldOutSection]) -> Table:
    columns = [
        TableColumn("Readings", wide=True),
        TableColumn("Channel"),
        *TableColumn.numbers(
            "Number", "Rms", "Rms, unadjusted", "Inside 95 % interval"
        ),
    ]
    rows = [
        [
            entry.name,
            entry.channel,
            str(entry.n),
            text.quantity(entry.rms, entry.unit),
            text.quantity(entry.rms_raw, entry.unit),
            text.percent(entry.coverage),
        ]
        for entry in sets
    ]
    marks = ["good" if _is_covered(entry) else "bad" for entry in sets]
    return Table(columns, rows, CAPTION, marks)


HELD_OUT_CHAPTER: Final = Chapter("held-out", "Held-out prediction", held_out_blocks)
