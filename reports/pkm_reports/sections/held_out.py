"""Chapter: readings held out of the fit, and how well the fit predicts them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import HeldOutSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Picture,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.sections.figures import held_out

LEAST_COVERAGE: Final = 0.85
CAPTION: Final = (
    "Prediction of held-out readings. A new set-up has unknowns of its own (an offset, a"
    " scale). The first rms adjusts them to its readings; the second leaves them at"
    " their nominal values."
)


def blocks(result: StudyResult) -> list[Block]:
    """Residuals with predictive intervals, and a table of rms and coverage."""
    sets = result.held_out
    if not sets:
        return []
    picture = Picture("held_out", lambda: held_out.draw(sets), _caption(sets))
    return [picture, _table(sets)]


def _caption(sets: Sequence[HeldOutSection]) -> str:
    inside = [
        f"{text.percent(entry.coverage)} of {entry.n} in {_name(entry)}"
        for entry in sets
    ]
    caption = (
        "Measured minus predicted, for readings that the fit did not use. Inside their"
        f" 95 % interval: {text.listing(inside)}."
    )
    narrow = [_name(entry) for entry in sets if not _is_covered(entry)]
    if narrow:
        return (
            f"{caption} That is too few in {text.listing(narrow)}: the stated"
            " uncertainty is too small there."
        )
    return f"{caption} That agrees with the stated uncertainty."


def _name(entry: HeldOutSection) -> str:
    return f"{entry.name} ({entry.channel})"


def _is_covered(entry: HeldOutSection) -> bool:
    return entry.coverage >= LEAST_COVERAGE


def _table(sets: Sequence[HeldOutSection]) -> Table:
    columns = [
        wide_column("Readings"),
        TableColumn("Channel"),
        *number_columns("Number", "Rms", "Rms, unadjusted", "Inside 95 % interval"),
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


CHAPTER: Final = Chapter("held-out", "Held-out prediction", blocks)
