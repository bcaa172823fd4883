"""report.html and report.pdf from the result of a study."""

from __future__ import annotations

from pathlib import Path

from oed.result import StudyResult
from oed.safe_files import write_own
from pkm_reports.page import Document, build_document


def write_report(
    result: StudyResult,
    out: Path,
    *,
    html: bool = True,
    pdf: bool = True,
    full: bool = False,
) -> tuple[Path, ...]:
    """Write `report.html` and `report.pdf`, or one of them, into the folder `out`.

    The PDF is a print of at most some four pages; `full`, it has all that the HTML has.

    The folder is created where it is missing. Files appear complete or not at all. One
    that the user changed stays, and the new one gets a number. Returns the paths, HTML
    first. Raises OSError where the folder cannot be written.
    """
    document = build_document(result)
    return write_document(document, out, "report", html=html, pdf=pdf, full=full)


def write_document(
    report: Document,
    out: Path,
    name: str,
    *,
    html: bool = True,
    pdf: bool = True,
    full: bool = False,
) -> tuple[Path, ...]:
    """Write a document as `NAME.html` and `NAME.pdf` into the folder `out`."""
    pages: dict[str, bytes] = {}
    if html:
        pages[f"{name}.html"] = report.html()
    if pdf:
        pages[f"{name}.pdf"] = report.pdf(full=full)
    out.mkdir(parents=True, exist_ok=True)
    return tuple(write_own(out / file, page) for file, page in pages.items())
