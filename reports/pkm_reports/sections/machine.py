"""The machine's parameters and the set-ups, explained where they first stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import MachineInfo, SetupInfo
from pkm_reports import text
from pkm_reports.blocks import Block, Table, TableColumn, wide_column

#: columns of the machine's table that hold sentences
SENTENCES: Final = ("about", "text")
#: titles of the columns of the machine's table
TITLES: Final = {
    "name": "Parameter",
    "about": "What it is",
    "held": "In the controller",
    "expected": "Prior mean",
}


def setups(setups: Sequence[SetupInfo]) -> list[Block]:
    """Settings, noise and unknowns of each set-up."""
    if not setups:
        return []
    columns = [
        TableColumn("Set-up"),
        wide_column("Instrument"),
        wide_column("Settings"),
        wide_column("Noise (1 sigma)"),
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


def parameters(machine: MachineInfo) -> list[Block]:
    """Each parameter with what it is, its nominal value and its tolerance."""
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
        TableColumn(_title(key), number=key in numeric, wide=key in SENTENCES)
        for key in keys
    ]
    rows = [[_cell(key, row.get(key)) for key in keys] for row in table]
    caption = (
        f"The parameters of {machine.name}. The tolerance is the standard deviation"
        " before any reading."
    )
    if machine.frame:
        caption += (
            " These stay at nominal, because they only choose the base frame:"
            f" {text.listing(machine.frame)}."
        )
    return [Table(columns, rows, caption)]


def _title(key: str) -> str:
    return TITLES[key] if key in TITLES else text.heading(key).capitalize()


def _cell(key: str, value: str | float | None) -> str:
    if isinstance(value, str):
        return text.unit_symbol(value) if key == "unit" else value
    return text.trimmed(value, 7)
