"""Sequences that the study asks for, against the best plan of the same time."""

from __future__ import annotations

from collections.abc import Sequence

from oed.result import AlternativePlan, PlanSection, SequenceRecord
from pkm_reports.figures import stage_accuracy
from pkm_reports.page import missing, text
from pkm_reports.page.blocks import (
    Block,
    Items,
    Table,
    number_columns,
    transposed,
    wide_column,
)
from pkm_reports.sections.stages import wording


def blocks(plan: PlanSection) -> list[Block]:
    """What the sequences determine, how they compare, and what follows from it."""
    compared = plan.compared
    if not compared:
        return []
    content: list[Block] = [_ranks(compared), _comparison(compared)]
    sentences = [f"{s.name}: {text.sentence(s.words)}" for s in compared if s.words]
    if sentences:
        content.append(Items(sentences))
    return content


def _ranks(compared: Sequence[SequenceRecord]) -> Table:
    indices = list(dict.fromkeys(key for s in compared for key in s.observability))
    columns = [
        wide_column("Sequence"),
        *number_columns("Readings", "Minutes", "Rank", "κ", "Weakest"),
        *number_columns(*indices, "Lost"),
    ]
    cells = [
        [s.name for s in compared],
        [_total(s.sequence) for s in compared],
        [text.number(s.sequence.minutes) for s in compared],
        [f"{s.rank} of {s.parameters}" for s in compared],
        [text.number(s.kappa, 4) for s in compared],
        [text.number(s.weakest) for s in compared],
    ]
    for index in indices:
        cells.append(
            [text.number(missing.entry(s.observability, index)) for s in compared]
        )
    cells.append([text.trimmed(s.lost, 2) for s in compared])
    caption = (
        "Sequences that the study asks for, with all readings of each measurement."
        " Weakest: the smallest singular value (lengths in mm, angles times the lever)."
        " O1 to O5 are the observability indices, larger is better; the smaller κ, the"
        " better."
    )
    return Table(columns, transposed(cells), caption)


def _total(plan: AlternativePlan) -> str:
    return text.trimmed(sum(plan.readings)) if plan.readings else text.MISSING


def _comparison(compared: Sequence[SequenceRecord]) -> Table:
    """Three rows for each sequence: itself, the best plan of its time, the gain."""
    plans = [plan for s in compared for plan in (s.sequence, s.plan)]
    keys = list(dict.fromkeys(key for plan in plans for key in plan.accuracy))
    rows, marks = [], []
    for record in compared:
        best = wording.measurements(record.plan)
        rows.append(_row(record.name, record.sequence, "", keys))
        rows.append(_row(best, record.plan, text.number(record.bound), keys))
        marks += ["", "chosen"]
        if record.gain:
            factors = [
                text.times(stage_accuracy.of_component(record.gain, key))
                for key in keys
            ]
            rows.append(["… times as accurate", "", "", "", *factors])
            marks.append("chosen")
    columns = [
        wide_column("Sequence"),
        *number_columns("Minutes", "Value", "Bound"),
        *number_columns(*[text.heading(key) for key in keys]),
    ]
    caption = (
        "Each sequence, and below it (marked) the best plan found in its time: value"
        " (smaller is better) and rms error of each component. No plan of that time has"
        " a value below the bound."
    )
    return Table(columns, rows, caption, marks)


def _row(
    name: str, plan: AlternativePlan, bound: str, keys: Sequence[str]
) -> list[str]:
    head = [name, text.number(plan.minutes), text.number(plan.value), bound]
    return [*head, *wording.cells(plan.accuracy, keys)]
