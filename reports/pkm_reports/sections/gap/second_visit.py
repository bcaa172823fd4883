"""Chapter: a second visit, and what its readings are expected to decide."""

from __future__ import annotations

from typing import Final

from oed.result import StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Chapter, Paragraph
from pkm_reports.sections.gap import runs


def blocks(result: StudyResult) -> list[Block]:
    """What the visit is worth, and its runs; nothing where the diagnosis is sure."""
    visit = None if result.gap is None else result.gap.second_visit
    if visit is None:
        return []
    caption = (
        "Runs of a second visit, in the file second_visit.csv with a row for each pose"
    )
    poses = [str(count) for count in visit.poses]
    return [
        Paragraph(" ".join(text.sentences(visit.words))),
        runs.table(visit.runs, "Poses", poses, f"{caption}."),
    ]


CHAPTER: Final = Chapter("second_visit", "A second visit", blocks, blocks)
