"""The chapters of a report, in order; each module of this folder has its `CHAPTER`."""

from __future__ import annotations

from typing import Final

from oed.result import StudyResult
from pkm_reports.blocks import Chapter, Section
from pkm_reports.sections import (
    acceptance,
    accuracy,
    corrected,
    held_out,
    identifiability,
    identification,
    kappa,
    plan,
    posterior,
    record,
)
from pkm_reports.sections.design import chapter as design
from pkm_reports.sections.gap import before as gap_before
from pkm_reports.sections.gap import chapter as gap
from pkm_reports.sections.stages import chapter as stages

#: chapters of every report; one whose stage did not run says so in a sentence
CHAPTERS: Final = (
    plan.CHAPTER,
    design.CHAPTER,
    kappa.CHAPTER,
    identifiability.CHAPTER,
    identification.CHAPTER,
    posterior.CHAPTER,
    accuracy.CHAPTER,
    held_out.CHAPTER,
    record.CHAPTER,
)


def chapters(result: StudyResult) -> list[Section]:
    """All chapters of a report.

    A diagnosis comes first, then the model corrected for it and the
    acceptance test, then what the readings could detect, then a plan in
    stages: only results that hold these have their chapters.
    """
    leading: list[Chapter] = []
    if result.gap is not None:
        leading.append(gap.CHAPTER)
    if result.corrected is not None:
        leading.append(corrected.CHAPTER)
    if result.acceptance is not None:
        leading.append(acceptance.CHAPTER)
    if result.gap_before is not None:
        leading.append(gap_before.CHAPTER)
    if stages.has_schedule(result.plan):
        leading.append(stages.CHAPTER)
    return [chapter.section(result) for chapter in (*leading, *CHAPTERS)]
