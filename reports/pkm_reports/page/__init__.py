"""Pages: a document of numbered blocks, written as HTML and PDF, and sheets for the machine.

Content                 title, first page, chapters and appendix of a document
Document                such a document with its blocks numbered
page_script             the script of a page
script_digest           digest of a page's script, for its content policy
template_environment    templates that escape every text
write_sheet             the sheet that the operator fills in
write_adjustment_page   what to adjust at the machine, as PDF
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_reports.page.document import (
        Content,
        Document,
        page_script,
        script_digest,
        template_environment,
    )
    from pkm_reports.page.sheet import write_adjustment_page, write_sheet
else:
    __getattr__ = door(__name__)
