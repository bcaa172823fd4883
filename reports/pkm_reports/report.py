"""report.html and report.pdf from the result of a study."""

from pathlib import Path

from oed.result import StudyResult
from pkm_reports.page import Document


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
    Returns the paths. As `Document.write`; raises OSError where that does.
    """
    return Document.from_result(result).write(
        out, "report", html=html, pdf=pdf, full=full
    )
