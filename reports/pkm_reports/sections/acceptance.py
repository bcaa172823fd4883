"""Chapter: the acceptance test, and whether the machine passed it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import (
    AcceptanceSection,
    PromiseRecord,
    RunCurve,
    StudyResult,
    VerificationSection,
)
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
    number_columns,
)
from pkm_reports.sections.figures import run_curves


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
    chapter.append(_demands(acceptance))
    if acceptance.further:
        chapter.append(_further_demands(acceptance))
    chapter.append(_poses(acceptance))
    return chapter


def printed(result: StudyResult) -> list[Block]:
    """Verdict, demands and poses."""
    if result.acceptance is None:
        return []
    test = result.verification
    verdict_blocks = [] if test is None else _verdict(test)
    return [*verdict_blocks, _demands(result.acceptance), _poses(result.acceptance)]


def _runs(curves: Sequence[RunCurve]) -> list[Block]:
    """Readings along circles and lines of the compensated machine."""
    if not curves:
        return []
    caption = run_curves.caption(curves)
    picture = Picture(
        "runs_after", lambda: run_curves.draw(curves, after=True), caption
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


def _demands(acceptance: AcceptanceSection) -> Table:
    columns = [
        TableColumn("Component"),
        *number_columns(
            "Promised rms", "Meets to", "Fails above", "Uncertainty", "Power"
        ),
    ]
    demands = acceptance.components.items()
    rows = [[_component(name, d), *_demand(d)] for name, d in demands]
    caption = (
        "Demands on the rms of the errors measured at the poses below. Between the two"
        " limits the test cannot tell; without a lower one its power is too small to"
        " confirm. Uncertainty: of one measured error, one standard deviation."
    )
    return Table(columns, rows, caption)


def _further_demands(acceptance: AcceptanceSection) -> Table:
    columns = [
        TableColumn("Component"),
        *number_columns("Without", "With: promised", "Meets to", "Fails above"),
        *number_columns("Uncertainty", "Power"),
    ]
    rows = [
        [
            _component(name, d),
            "" if d.without is None else text.number(d.without),
            *_demand(d),
        ]
        for name, d in acceptance.further.items()
    ]
    caption = (
        "What no drive corrects, as rms errors without additional axes, and with axes that"
        " take the known error back (columns with “offset” of the compensation table)."
    )
    return Table(columns, rows, caption)


def _component(name: str, demand: PromiseRecord) -> str:
    return f"{name} [{text.unit_symbol(demand.unit)}]"


def _demand(demand: PromiseRecord) -> list[str]:
    """Cells of a demand: promised, both limits, uncertainty, power."""
    return [
        text.number(demand.promised),
        text.MISSING if demand.confirms is None else text.number(demand.confirms),
        text.number(demand.limit),
        text.number(demand.uncertainty, 2),
        text.fixed(demand.power, 2),
    ]


def _poses(acceptance: AcceptanceSection) -> Table:
    titles = [text.heading(name) for name in acceptance.poses[0]]
    rows = [[text.trimmed(v, 6) for v in pose.values()] for pose in acceptance.poses]
    return Table(number_columns(*titles), rows, "Poses to measure.")


def _verdict(verification: VerificationSection) -> list[Block]:
    columns = [
        TableColumn("Component"),
        *number_columns("Measured rms", "Limit", "Largest"),
        TableColumn("Verdict"),
    ]
    rows, marks = [], []
    for name, c in verification.components.items():
        unit = text.unit_symbol(c.unit)
        sizes = [text.number(v) for v in (c.rms, c.limit, c.max)]
        rows.append([f"{name} [{unit}]", *sizes, text.VERDICTS[c.judgement]])
        marks.append(text.MARKS[c.judgement])
    caption = f"Measured errors against their limits. {verdict(verification)}"
    blocks: list[Block] = [Table(columns, rows, caption, marks)]
    if verification.further:
        blocks.append(_further_verdict(verification))
    if verification.positioning:
        blocks.append(_positioning(verification))
    return blocks


def _further_verdict(verification: VerificationSection) -> Table:
    columns = [
        TableColumn("Component"),
        *number_columns("Without: rms", "With: rms", "Limit", "Largest"),
        TableColumn("Verdict"),
    ]
    rows, marks = [], []
    for name, c in verification.further.items():
        sizes = [text.number(v) for v in (c.rms, c.limit, c.max)]
        without = "" if c.without is None else text.number(c.without)
        title = f"{name} [{text.unit_symbol(c.unit)}]"
        rows.append([title, without, *sizes, text.VERDICTS[c.judgement]])
        marks.append(text.MARKS[c.judgement])
    caption = (
        "What no drive corrects: measured errors without additional axes, and with axes that"
        " take the known error back."
    )
    return Table(columns, rows, caption, marks)


def _positioning(verification: VerificationSection) -> Table:
    columns = [
        TableColumn("Component"),
        *number_columns("Targets", "Approaches", "A", "E", "R", "M", "B"),
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
