"""Chapter: the key figures of the study, in the words of the command's output."""

from __future__ import annotations

from typing import Final

from oed.result import StudyResult
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Chapter, Items


def blocks(result: StudyResult) -> list[Block]:
    """The headline of the result; findings about the readings stand on the first page."""
    alarms = [] if result.goodness is None else result.goodness.findings
    lines = [text.sentence(line) for line in result.headline if line not in alarms]
    return [Items(lines, numbered=True)] if lines else []


CHAPTER: Final = Chapter("figures", "Key figures", blocks)
