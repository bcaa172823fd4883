"""What a terminal shows of a report: its first lines, and one accuracy a component."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Final

from oed.result import StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Paragraph, Table
from pkm_reports.sections.answer import answer_parts, is_plan

#: sentences of a diagnosis, the verdict among them
MAX_FINDINGS: Final = 3


@dataclasses.dataclass(frozen=True, slots=True)
class FirstLines:
    """The first page in a few lines.

    sentences    what was read or is to be, how accurate, the main doubt
    table        of the accuracy; None without a prediction
    findings     of a diagnosis: how large the causes are, and where
    actions      what to do next
    warnings     those beside the main doubt
    is_plan      whether readings are to be taken, not evaluated
    """

    sentences: list[str]
    table: Table | None
    findings: list[str]
    actions: list[str]
    warnings: list[str]
    is_plan: bool


def first_lines(result: StudyResult) -> FirstLines:
    """The lines of a result, plain: no typographic spaces."""
    parts: dict[str, Sequence[Block]] = {
        "short": (),
        "how-accurate": (),
        "warnings": (),
    }
    parts |= {part.anchor: part.blocks for part in answer_parts(result)}
    gap = result.gap
    tables = [block for block in parts["how-accurate"] if isinstance(block, Table)]
    return FirstLines(
        sentences=_sentences(parts["short"]),
        table=tables[0] if tables else None,
        findings=[] if gap is None else _plain(gap.words[1:MAX_FINDINGS]),
        actions=[] if gap is None else _plain(gap.next[:1]),
        warnings=_sentences(b for b in parts["warnings"] if isinstance(b, Notice)),
        is_plan=is_plan(result),
    )


def _plain(phrases: Sequence[str]) -> list[str]:
    return [text.plain(sentence) for sentence in text.sentences(phrases)]


def _sentences(blocks: Iterable[Block]) -> list[str]:
    """The words of paragraphs and notices, as a terminal shows them."""
    return [
        text.plain(block.text)
        for block in blocks
        if isinstance(block, Paragraph | Notice)
    ]
