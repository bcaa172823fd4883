"""Diagnoses of several results side by side."""

from __future__ import annotations

from collections.abc import Mapping

from oed.result import GapSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.sections import explanation_row


def blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """The likeliest explanation of each result, with the residual before and after."""
    diagnoses = {n: r.gap for n, r in results.items() if r.gap is not None}
    if not diagnoses:
        return []
    columns = [
        TableColumn("Result"),
        wide_column("Likeliest explanation"),
        *number_columns("Probability", "Residual before, rms", "after"),
    ]
    rows = [_row(name, gap) for name, gap in diagnoses.items()]
    caption = "The likeliest explanation of what calibration leaves."
    return [Table(columns, rows, caption)]


def _row(name: str, gap: GapSection) -> list[str]:
    cells = [name, text.MISSING, text.MISSING]
    if gap.answers:
        explanation, probability, _ = explanation_row(gap.answers[0])
        cells = [name, explanation, probability]
    return [*cells, _rms(gap, gap.rms_before), _rms(gap, gap.rms_after)]


def _rms(gap: GapSection, rms: Mapping[str, float]) -> str:
    sizes = [f"{n} {text.channel_value(n, v, gap.units)}" for n, v in rms.items()]
    return text.listing(sizes) or text.MISSING
