"""Reports of a finished study: figures, HTML and PDF, and a sheet to take to the
machine.

    from pkm_reports import write_report, write_sheet
    html, pdf = write_report(json.loads(path.read_bytes()), path.parent)

A report needs only the decoded `result.json`, so it can be made again at any time, with
the same HTML bytes.
"""

from pkm_reports.report import write_report
from pkm_reports.sheet import write_sheet

__all__ = ["write_report", "write_sheet"]
