"""The chapters of a report, in order; each module of this folder has its `CHAPTER`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import StudyResult
from pkm_reports.page.blocks import Chapter, Section
from pkm_reports.sections import (
    acceptance,
    accuracy,
    adjustment,
    corrected,
    forecast,
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
from pkm_reports.sections.gap import mixture, second_visit
from pkm_reports.sections.stages import chapter as stages

#: chapters in order; one that does not apply to a result is absent from its report
CHAPTERS: Final = (
    plan.CHAPTER,
    stages.CHAPTER,
    design.CHAPTER,
    identifiability.CHAPTER,
    kappa.CHAPTER,
    identification.CHAPTER,
    posterior.CHAPTER,
    accuracy.CHAPTER,
    held_out.CHAPTER,
    gap.CHAPTER,
    second_visit.CHAPTER,
    corrected.CHAPTER,
    mixture.CHAPTER,
    adjustment.CHAPTER,
    forecast.CHAPTER,
    acceptance.CHAPTER,
    gap_before.CHAPTER,
)
#: what only a reader who checks the work needs
APPENDIX: Final = (record.CLAIMS, record.FIGURES, record.RECORD)


def chapters(result: StudyResult) -> list[Section]:
    """The chapters that apply to a result: plan, what it determines, fit, accuracy, gap."""
    return _applying(CHAPTERS, result)


def appendix(result: StudyResult) -> list[Section]:
    """Claims, key figures, versions and study file."""
    return _applying(APPENDIX, result)


def _applying(candidates: Sequence[Chapter], result: StudyResult) -> list[Section]:
    written = [chapter.section(result) for chapter in candidates]
    return [section for section in written if section.blocks]
