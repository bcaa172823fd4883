"""Poses and set-ups polished off the grid: what it gained, and the new settings."""

from __future__ import annotations

from oed.result import DesignSection
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Paragraph, Table, TableColumn, wide_column
from pkm_reports.sections.design.certificate import criterion_value


def blocks(design: DesignSection) -> list[Block]:
    """Criterion before and after, and the set-ups that moved."""
    polish = design.polished
    if polish is None:
        return []
    criterion = design.criterion
    before = criterion_value(criterion, polish.before)
    after = criterion_value(criterion, polish.after)
    sentence = f"Polishing off the grid brings criterion {criterion}"
    sentence += f" from {before} to {after}"
    if polish.before == polish.after:
        sentence = f"Polishing off the grid leaves criterion {criterion} at {after}"
    if polish.words and polish.words not in design.words:
        sentence += f": {polish.words}"
    content: list[Block] = [Paragraph(text.sentence(sentence))]
    if polish.setups:
        columns = [TableColumn("Set-up"), wide_column("Set it to")]
        rows = [
            [name, text.named_quantities(settings)]
            for name, settings in polish.setups.items()
        ]
        count = text.count(len(rows), "set-up")
        caption = f"New settings of the set-ups that polishing moved: {count}."
        content.append(Table(columns, rows, caption))
    return content
