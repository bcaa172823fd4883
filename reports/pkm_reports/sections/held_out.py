"""Readings kept out of the fit, predicted by it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import Block, Picture, Table, TableColumn, absent, number_column
from pkm_reports.figures import held_out

ANCHOR: Final = "held-out"
TITLE: Final = "Held-out prediction"
LEAST_COVERAGE: Final = 0.85
CAPTION: Final = (
    "Prediction of held-out readings. A new set-up brings unknowns of its own (an"
    " offset, a scale): they are adjusted to its readings in the first rms, and left at"
    " their nominal values in the second."
)


def blocks(result: Mapping[str, Any]) -> list[Block]:
    """Residuals with predictive intervals, and a table of rms and coverage."""
    sets = result.get("held_out") or []
    if not sets:
        return absent("Prediction of readings kept out of the fit")
    return [
        Picture("held_out", lambda: held_out.draw(sets), _caption(sets)),
        _table(sets),
    ]


def _caption(sets: list[Mapping[str, Any]]) -> str:
    narrow = [
        f"{s['name']} ({s['channel']})"
        for s in sets
        if not words.number(s["coverage"]) >= LEAST_COVERAGE
    ]
    inside = words.listing(
        f"{words.percent(s['coverage'])} of {s['n']} in {s['name']} ({s['channel']})"
        for s in sets
    )
    text = (
        "Measured minus predicted, for readings that the fit did not see. Inside their"
        f" 95 % interval: {inside}."
    )
    if narrow:
        return (
            f"{text} That is too few in {words.listing(narrow)}: the stated uncertainty"
            " is too small there."
        )
    return (
        f"{text} That is about as many as should be: the stated uncertainty can be"
        " trusted."
    )


def _table(sets: list[Mapping[str, Any]]) -> Table:
    rows = [
        [
            str(s["name"]),
            str(s["channel"]),
            str(s["n"]),
            words.quantity(s["rms"], str(s["unit"])),
            words.quantity(s.get("rms_raw"), str(s["unit"])),
            words.percent(s["coverage"]),
        ]
        for s in sets
    ]
    columns = [
        TableColumn("Readings", wide=True),
        TableColumn("Channel"),
        *number_column("Number", "Rms", "Rms, unadjusted", "Inside 95 % interval"),
    ]
    marks = [
        "good" if words.number(s["coverage"]) >= LEAST_COVERAGE else "bad" for s in sets
    ]
    return Table(columns, rows, CAPTION, marks)
