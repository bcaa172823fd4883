"""What was computed with what: warnings, set-ups, machine table, study file, versions
and seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Code,
    Items,
    Paragraph,
    Table,
    TableColumn,
    text_column,
)

ANCHOR: Final = "record"
TITLE: Final = "Record"
Part = Mapping[str, Any]


def blocks(result: Part) -> list[Block]:
    """Everything needed to run the study again."""
    warnings = [words.sentence(w) for w in result.get("warnings") or []]
    made: list[Block] = (
        [Paragraph("Warnings:"), Items(warnings)]
        if warnings
        else [Paragraph("There are no warnings.")]
    )
    made += _setups(result.get("setups") or [])
    made += _machine(result["machine"])
    made += [
        _versions(result),
        Paragraph("The study file:"),
        Code(str(result.get("study_text", ""))),
    ]
    return made


def _setups(setups: Sequence[Part]) -> list[Block]:
    if not setups:
        return []
    rows = [
        [
            str(s["name"]),
            (
                f"{s['instrument']}: {words.sentence(s['about'])}"
                if s.get("about")
                else str(s["instrument"])
            ),
            words.numbers(s.get("numbers") or {}),
            words.numbers(s.get("sigma") or {}),
            words.numbers(s.get("unknowns") or {}),
        ]
        for s in setups
    ]
    columns = [
        TableColumn("Set-up"),
        TableColumn("Instrument", wide=True),
        TableColumn("Settings", wide=True),
    ]
    columns += [
        *text_column("Noise (1 sigma)"),
        TableColumn("Unknowns and tolerances", wide=True),
    ]
    return [
        Table(
            columns,
            rows,
            f"{words.count(len(setups), 'set-up')} as used: settings, noise, and"
            " unknowns that are identified too.",
        )
    ]


def _machine(info: Part) -> list[Block]:
    table = info.get("parameters") or []
    if not table:
        return []
    keys = list(dict.fromkeys(key for row in table for key in row))
    numeric = {
        k for k in keys if all(isinstance(row.get(k), (int, float)) for row in table)
    }
    columns = [
        TableColumn(words.heading(k), number=k in numeric, wide=k in ("about", "text"))
        for k in keys
    ]
    rows = [[_cell(key, row.get(key)) for key in keys] for row in table]
    caption = f"Parameters of {info['name']}, nominal and tolerance."
    if info.get("frame"):
        caption += (
            " Held at nominal, because they only choose the base frame:"
            f" {words.listing(info['frame'])}."
        )
    return [Table(columns, rows, caption)]


def _cell(key: str, value: Any) -> str:
    if isinstance(value, str):
        return words.unit(value) if key == "unit" else value
    return words.plain(value, 7)


def _versions(result: Part) -> Table:
    rows = [["study", str(result["study"])], ["seed", str(result["seed"])]]
    rows += [
        ["time", words.quantity(result.get("seconds"), "s")],
        ["result schema", str(result["schema"])],
    ]
    rows += [["pkm-oed", str(result["version"])]]
    rows += [
        [str(k), str(v)]
        for k, v in (result.get("versions") or {}).items()
        if k != "pkm-oed"
    ]
    caption = "Seed and versions: the same ones give the same numbers."
    return Table([TableColumn("What"), TableColumn("Value", wide=True)], rows, caption)
