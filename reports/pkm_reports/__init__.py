"""Reports of finished studies: figures, HTML and PDF, and a sheet for the machine.

    from pkm_reports import write_report, write_sheet
    result = msgspec.json.decode(path.read_bytes(), type=StudyResult)
    html, pdf = write_report(result, path.parent)

A report needs only the result, so it can be written again at any time, with the same
bytes of HTML.
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_reports.comparison import write_comparison
    from pkm_reports.page import write_adjustment_page, write_sheet
    from pkm_reports.report import write_report
    from pkm_reports.sections import first_lines
else:
    # imported when first used: a terminal's lines need no page and no figures
    __getattr__ = door(__name__)
