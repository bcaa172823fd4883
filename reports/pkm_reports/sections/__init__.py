"""The content of a report: its first page, its chapters in order, and their figures.

chapters           the chapters that apply to a result, in order
appendix           claims, versions and study file
answer_parts       the first page: what the user asked, answered
comparison_parts   first page and chapters of several results side by side
first_lines        what a terminal shows of the first page
adjustment_blocks  what a fitter adjusts, for a page of its own
draw_closure       a machine that does not assemble, and what keeps it open
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from oed.base import door
from oed.result import StudyResult
from pkm_reports.blocks import Chapter, Section
from pkm_reports.sections import (
    acceptance,
    accuracy,
    corrected,
    design,
    forecast,
    gap,
    gap_before,
    identifiability,
    identification,
    plan,
    posterior,
    record,
    stages,
)

if TYPE_CHECKING:
    from pkm_reports.sections.answer import answer_parts, first_lines
    from pkm_reports.sections.comparison import comparison_parts
    from pkm_reports.sections.corrected import adjustment_blocks
    from pkm_reports.sections.machine_figures import draw_closure
else:
    __getattr__ = door(__name__)

#: chapters in order; one that does not apply to a result is absent from its report
CHAPTERS: Final = (
    plan.CHAPTER,
    stages.CHAPTER,
    design.CHAPTER,
    identifiability.CHAPTER,
    identifiability.KAPPA_CHAPTER,
    identification.CHAPTER,
    posterior.CHAPTER,
    accuracy.CHAPTER,
    acceptance.HELD_OUT_CHAPTER,
    gap.CHAPTER,
    gap_before.VISIT_CHAPTER,
    corrected.CHAPTER,
    gap.MIXTURE_CHAPTER,
    corrected.ADJUSTMENT_CHAPTER,
    forecast.CHAPTER,
    acceptance.CHAPTER,
    gap_before.CHAPTER,
)
#: what only a reader who checks the work needs
APPENDIX: Final = (record.CLAIMS, record.RECORD)


def chapters(result: StudyResult) -> list[Section]:
    """The chapters that apply to a result: plan, what it determines, fit, accuracy, gap."""
    return _applying(CHAPTERS, result)


def appendix(result: StudyResult) -> list[Section]:
    """Claims, versions and study file."""
    return _applying(APPENDIX, result)


def _applying(candidates: Sequence[Chapter], result: StudyResult) -> list[Section]:
    written = [chapter.section(result) for chapter in candidates]
    return [section for section in written if section.blocks]
