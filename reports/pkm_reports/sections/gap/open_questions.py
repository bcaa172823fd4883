"""What the readings leave open: effects that look alike, effects that were not tested."""

from __future__ import annotations

from collections.abc import Sequence

from oed.result import GapSection
from pkm_reports.figures.gap.effects import spoken
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Table, TableColumn, headed_list, wide_column


def blocks(gap: GapSection) -> list[Block]:
    """Groups of effects that cannot be distinguished, then untested effects."""
    groups = [_group(gap, names) for names in gap.confusable if len(names) > 1]
    heading = "These readings cannot tell the effects of a group from one another:"
    return [*headed_list(heading, groups), *_untested(gap)]


def _group(gap: GapSection, names: Sequence[str]) -> str:
    notes = [gap.about[name] for name in names if name in gap.about]
    ways = dict.fromkeys(note.exposed_by for note in notes if note.exposed_by)
    group = text.listing(spoken(name) for name in names)
    if ways:
        group += f"; what tells them apart: {'; '.join(ways)}"
    return text.sentence(group)


def _untested(gap: GapSection) -> list[Block]:
    if not gap.not_testable:
        return []
    columns = [
        TableColumn("Effect"),
        wide_column("Why not"),
        wide_column("Record in the readings"),
    ]
    rows = []
    for name in gap.not_testable:
        reason, column = "", ""
        if name in gap.about:
            reason, column = gap.about[name].missing, gap.about[name].column
        rows.append([spoken(name), reason, column or text.MISSING])
    caption = (
        "Effects that these readings cannot test. Where a column is missing, they may"
        " act all the same."
    )
    return [Table(columns, rows, caption)]
