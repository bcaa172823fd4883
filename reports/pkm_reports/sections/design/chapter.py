"""Chapter: how good the plan is: its certificate, and comparisons with other plans."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from oed.result import DesignSection, StudyResult
from pkm_reports.page.blocks import Block, Chapter
from pkm_reports.sections.design import (
    certificate,
    criteria,
    effects,
    how_many,
    plans,
    polish,
    robust,
)

#: parts of the chapter; a part is empty where the result lacks what it shows
PARTS: Final[tuple[Callable[[DesignSection], list[Block]], ...]] = (
    certificate.blocks,
    polish.blocks,
    plans.blocks,
    criteria.blocks,
    effects.blocks,
    robust.blocks,
    how_many.blocks,
)


def blocks(result: StudyResult) -> list[Block]:
    """Certificate, polishing, reference plans, criteria, effects, scenarios, number of readings."""
    design = result.design
    if design is None:
        return []
    return [block for blocks_of in PARTS for block in blocks_of(design)]


CHAPTER: Final = Chapter("design", "How good the plan is", blocks)
