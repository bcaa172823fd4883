"""Poses and set-ups polished off the grid: what it brought."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pkm_reports import words
from pkm_reports.blocks import Block, Paragraph, Table, TableColumn
from pkm_reports.sections.parts import certificate


def blocks(design: Mapping[str, Any]) -> list[Block]:
    """Before and after, and where the set-ups that were moved stand now."""
    part = design.get("polished")
    if not part:
        return []
    name = str(design["criterion"])
    before, after = (
        certificate.told(name, part.get(key)) for key in ("before", "after")
    )
    text = f"Polishing off the grid brought criterion {name} from {before} to {after}"
    if part.get("before") == part.get("after"):
        text = f"Polishing off the grid left criterion {name} at {after}"
    how = str(part.get("words") or "")
    detail = (
        f": {words.pretty(how)}" if how and how not in str(design.get("words")) else ""
    )
    made: list[Block] = [Paragraph(words.sentence(text + detail))]
    moved = part.get("setups") or {}
    if moved:
        rows = [
            [str(setup), words.numbers(numbers)] for setup, numbers in moved.items()
        ]
        caption = (
            "What was free of the set-ups, as it is to be set up now:"
            f" {words.count(len(moved), 'set-up')} moved."
        )
        made.append(
            Table(
                [TableColumn("Set-up"), TableColumn("Set it to", wide=True)],
                rows,
                caption,
            )
        )
    return made
