"""What could go wrong or has gone wrong, the most harmful first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from oed import trust
from oed.result import PredictionSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Paragraph
from pkm_reports.sections.stages.chapter import is_missed


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    if trust.objections(result):
        return "The fit is not to be trusted"
    return "What could go wrong"


class Doubt(NamedTuple):
    """What spoils the figures most.

    words     as the first lines of the report have it; empty where there is none
    warning   the warning that it states; empty where it is none of them
    """

    words: str
    warning: str = ""


def blocks(result: StudyResult) -> list[Block]:
    """Findings about the readings, missed goals, failed claims, warnings, conditions.

    The one of the main doubt stands in the first lines of the report already.
    """
    sentences = _sentences(result)
    if not sentences:
        return [Paragraph("The study has no warnings.")]
    stated = main_doubt(result).warning
    return [Notice(sentence) for sentence in sentences if sentence != stated]


def main_doubt(result: StudyResult) -> Doubt:
    """What spoils the figures most, and what removes it."""
    worst = next(iter(_sentences(result)), "")
    checked = result.goodness
    findings = [] if checked is None else map(text.sentence, checked.findings)
    if trust.objections(result) or worst in findings:
        return Doubt(worst, worst)
    of_effects = _effects_doubt(result.prediction)
    if worst and not of_effects:
        return Doubt(f"Main doubt: {worst[:1].lower()}{worst[1:]}", worst)
    other = of_effects or _scope_doubt(result)
    return Doubt(f"Main doubt: {other}" if other else "")


def _sentences(result: StudyResult) -> list[str]:
    """All warnings once, those that spoil the most first."""
    return list(dict.fromkeys(map(text.sentence, ranked(result))))


def _effects_doubt(prediction: PredictionSection | None) -> str:
    """The effect beside the geometry that costs a planned machine most."""
    budget = None if prediction is None else prediction.budget
    if prediction is None or budget is None or not budget.unmodelled:
        return ""
    if prediction.mode != "plan":
        return ""
    largest = budget.unmodelled[0]
    effect = largest.effect.replace("_", " ")
    size = text.replace_symbols(largest.expected)
    return (
        f"{effect}, here at its expected size of {size}, can be ten times"
        f" larger or smaller. What removes it: {largest.remedy.rstrip('.')}."
    )


def _scope_doubt(result: StudyResult) -> str:
    """What figures leave out that nothing else speaks against."""
    if result.forecast is not None and result.forecast.sentences:
        holds = result.forecast.sentences[1:2] or result.forecast.sentences
        return (
            f"{holds[0].rstrip('.')}. What removes it: nodes read in the state of use."
        )
    if result.judged_prediction is None or result.gap is not None:
        return ""
    return (
        "the figures are of the geometry alone; heat, load, play and other effects come on"
        " top. What removes it: a test of the compensated machine, which oed verify plans."
    )


def fits_with_effects(result: StudyResult) -> bool:
    """Whether the fit with effects is delivered, and nothing speaks against it."""
    return result.corrected is not None and not result.corrected.warnings


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
    if result.corrected is not None and result.corrected.conditions:
        conditions = "; ".join(result.corrected.conditions)
        yield (
            f"The corrected accuracy rests on these conditions: {conditions}. What removes"
            " this: a test of the compensated machine, which oed verify plans"
        )
    if result.corrected is not None:
        yield from result.corrected.warnings
    if result.estimate is not None and not fits_with_effects(result):
        yield from result.estimate.warnings
    yield from result.warnings
