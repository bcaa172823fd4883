"""What could go wrong or has gone wrong, the most harmful first."""

from __future__ import annotations

from collections.abc import Iterator

from oed import trust
from oed.result import StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Paragraph
from pkm_reports.sections.stages.verdict import is_missed


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    if trust.objections(result):
        return "The fit is not to be trusted"
    return "What could go wrong"


def blocks(result: StudyResult) -> list[Block]:
    """Findings about the readings, missed goals, failed claims, warnings, conditions."""
    sentences = list(dict.fromkeys(map(text.sentence, ranked(result))))
    if not sentences:
        return [Paragraph("The study has no warnings.")]
    return [Notice(sentence) for sentence in sentences]


def ranked(result: StudyResult) -> Iterator[str]:
    """All warnings of a result, those that spoil the most first.

    A bad fit spoils everything; then what was promised and is not kept; then what a
    fit or a correction rests on.
    """
    objections = trust.objections(result)
    if result.goodness is not None:
        yield from result.goodness.findings
        if result.goodness.bad_fit and result.goodness.findings:
            objections = objections[1:]
    yield from objections
    if result.plan is not None and is_missed(result.plan):
        yield "The plan does not reach the wanted accuracy"
    failed = [claim.claim for claim in result.claims if not claim.met]
    if failed:
        noun = "a claim" if len(failed) == 1 else f"{len(failed)} claims"
        yield f"The study misses {noun}: {text.listing(failed)}"
    if result.corrected is not None:
        yield from result.corrected.warnings
    if result.estimate is not None:
        yield from result.estimate.warnings
    yield from result.warnings
    if result.corrected is not None and result.corrected.conditions:
        conditions = "; ".join(result.corrected.conditions)
        yield f"The corrected accuracy rests on these conditions: {conditions}"
