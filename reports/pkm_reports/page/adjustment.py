"""The page for the fitter: what to adjust, with room to write."""

from __future__ import annotations

from pathlib import Path

from oed.result import StudyResult
from oed.safe_files import write_own
from pkm_reports.blocks import Section
from pkm_reports.page import document, pdf
from pkm_reports.page.document import Content
from pkm_reports.sections import adjustment_blocks


def write_adjustment_page(result: StudyResult, folder: Path) -> Path:
    """Write `adjustment.pdf` into a folder and return its path.

    Raises ValueError where the result has no adjustments, OSError where the folder
    cannot be written.
    """
    section = result.adjustment
    if section is None:
        raise ValueError("this result has no adjustments")
    content = Content(
        title=result.title or result.study,
        question="What to adjust, in which order, and what it brings",
        study=result.study,
        machine=result.machine.name,
        foot=document.footer(result),
        answer=[Section("adjust", "Adjust", adjustment_blocks(section))],
        chapters=[],
        appendix=[],
    )
    page = pdf.render_pdf(document.assembled(content))
    return write_own(folder / "adjustment.pdf", page)
