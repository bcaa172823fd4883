"""The first page: what a user asked, answered before anything is explained.

Each module of this folder answers one question; a question that a result does not
answer has no part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from oed.result import StudyResult
from pkm_reports.blocks import Block, Section
from pkm_reports.sections.answer import (
    accuracy,
    causes,
    lead,
    measure,
    unknown,
    warnings,
)

#: anchor, title and content of each part, in order
Part = tuple[str, Callable[[StudyResult], str], Callable[[StudyResult], list[Block]]]
PARTS: Final[tuple[Part, ...]] = (
    ("short", lead.title, lead.blocks),
    ("causes", causes.title, causes.blocks),
    ("measure", measure.title, measure.blocks),
    ("how-accurate", accuracy.title, accuracy.blocks),
    ("unknown", unknown.title, unknown.blocks),
    ("warnings", warnings.title, warnings.blocks),
)


def answer_parts(result: StudyResult) -> list[Section]:
    """The parts of the first page that this result can answer."""
    content = [
        Section(anchor, title(result), blocks(result))
        for anchor, title, blocks in PARTS
    ]
    return [part for part in content if part.blocks]
