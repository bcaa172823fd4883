"""Chapter: the gap between model and machine: its causes, its places, its remedy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from oed.result import GapSection, StudyResult
from pkm_reports.figures.gap import effects
from pkm_reports.page import missing, text
from pkm_reports.page.blocks import (
    Block,
    Chapter,
    Items,
    Paragraph,
    Picture,
    headed_list,
)
from pkm_reports.sections.gap import (
    closure,
    coefficients,
    explanations,
    open_questions,
    pictures,
    places,
)


def blocks(result: StudyResult) -> list[Block]:
    """Findings, remedy, causes, places, closure, residuals, what remains open."""
    gap = result.gap
    if gap is None:
        return []
    caption = explanations.probabilities_caption(gap)
    return [
        Items(text.sentences(gap.words), numbered=True),
        *headed_list("What to do next:", text.sentences(gap.next)),
        Picture("gap_causes", lambda: effects.draw(gap), caption),
        *explanations.blocks(gap),
        *places.blocks(gap),
        *closure.blocks(gap),
        *_residuals(gap),
        *pictures.blocks(gap),
        *open_questions.blocks(gap),
        *coefficients.blocks(gap),
    ]


def _residuals(gap: GapSection) -> list[Block]:
    """The rms residual before and after, and what the noise is."""
    sentences = text.sentences(gap.noise)
    if gap.rms_before:
        sentences = [_rms(gap), *sentences]
    return [Paragraph(" ".join(sentences))] if sentences else []


def _rms(gap: GapSection) -> str:
    before, after = gap.rms_before, gap.rms_after
    if before == after:
        sizes = [f"{_rms_of(gap, n, before)} ({n})" for n in before]
        return f"The rms residual of all readings is {text.listing(sizes)}."
    changes = [
        f"from {_rms_of(gap, name, before)} to {_rms_of(gap, name, after)} ({name})"
        for name in before
    ]
    falls = all(missing.entry(after, name) <= rms for name, rms in before.items())
    verb = "falls" if falls else "changes"
    return f"The rms residual of all readings {verb} {text.listing(changes)}."


def _rms_of(gap: GapSection, channel: str, rms: Mapping[str, float]) -> str:
    return text.in_unit_of(channel, missing.entry(rms, channel), gap.units)


CHAPTER: Final = Chapter("gap", "The gap: causes, place, remedy", blocks)
