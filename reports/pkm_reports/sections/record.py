"""Chapter: what was computed with what: warnings, set-ups, machine, study, versions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import MachineInfo, SetupInfo, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Code,
    Paragraph,
    Table,
    TableColumn,
    headed_list,
    wide_column,
)

#: columns of the machine's table that hold sentences
SENTENCES: Final = ("about", "text")


def blocks(result: StudyResult) -> list[Block]:
    """Everything needed to run the study again."""
    warnings = headed_list("Warnings:", text.sentences(result.warnings))
    return [
        *(warnings or [Paragraph("There are no warnings.")]),
        *_setups(result.setups),
        *_machine(result.machine),
        _versions(result),
        Paragraph("The study file:"),
        Code(result.study_text),
    ]


def _setups(setups: Sequence[SetupInfo]) -> list[Block]:
    if not setups:
        return []
    columns = [
        TableColumn("Set-up"),
        wide_column("Instrument"),
        wide_column("Settings"),
        TableColumn("Noise (1 sigma)"),
        wide_column("Unknowns and tolerances"),
    ]
    rows = [
        [
            setup.name,
            _instrument(setup),
            text.named_quantities(setup.numbers),
            text.named_quantities(setup.sigma),
            text.named_quantities(setup.unknowns),
        ]
        for setup in setups
    ]
    caption = (
        f"{text.count(len(setups), 'set-up')} as used: settings, noise, and the"
        " unknowns that the fit identifies as well."
    )
    return [Table(columns, rows, caption)]


def _instrument(setup: SetupInfo) -> str:
    if not setup.about:
        return setup.instrument
    return f"{setup.instrument}: {text.sentence(setup.about)}"


def _machine(machine: MachineInfo) -> list[Block]:
    table = machine.parameters
    if not table:
        return []
    keys = list(dict.fromkeys(key for row in table for key in row))
    numeric = {
        key
        for key in keys
        if all(key in row and not isinstance(row[key], str) for row in table)
    }
    columns = [
        TableColumn(text.heading(key), number=key in numeric, wide=key in SENTENCES)
        for key in keys
    ]
    rows = [[_cell(key, row.get(key)) for key in keys] for row in table]
    caption = f"Parameters of {machine.name}, nominal and tolerance."
    if machine.frame:
        caption += (
            " These stay at nominal, because they only choose the base frame:"
            f" {text.listing(machine.frame)}."
        )
    return [Table(columns, rows, caption)]


def _cell(key: str, value: str | float | None) -> str:
    if isinstance(value, str):
        return text.unit_symbol(value) if key == "unit" else value
    return text.trimmed(value, 7)


def _versions(result: StudyResult) -> Table:
    rows = [
        ["study", result.study],
        ["seed", str(result.seed)],
        ["time", text.quantity(result.seconds, "s")],
        ["result schema", str(result.schema)],
        ["pkm-oed", result.version],
    ]
    others = {n: v for n, v in result.versions.items() if n != "pkm-oed"}
    rows += [[name, version] for name, version in others.items()]
    caption = "Seed and versions: the same ones give the same numbers."
    return Table([TableColumn("What"), wide_column("Value")], rows, caption)


CHAPTER: Final = Chapter("record", "Record", blocks)
