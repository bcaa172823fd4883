"""Chapter: what was computed with what: seed, versions, study file."""

from __future__ import annotations

from typing import Final

from oed.result import StudyResult
from pkm_reports.page import text
from pkm_reports.page.blocks import (
    Block,
    Chapter,
    Code,
    Paragraph,
    Table,
    TableColumn,
    wide_column,
)


def blocks(result: StudyResult) -> list[Block]:
    """Everything needed to run the study again."""
    content: list[Block] = [_versions(result)]
    if result.study_text:
        content += [Paragraph("The study file:"), Code(result.study_text)]
    return content


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
