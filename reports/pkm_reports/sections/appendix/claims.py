"""Chapter: the claims of the study, measured."""

from __future__ import annotations

from typing import Final

from oed.base.text import shorten
from oed.result import StudyResult
from pkm_reports.page import text
from pkm_reports.page.blocks import (
    Block,
    Chapter,
    Table,
    TableColumn,
    wide_column,
)

#: characters of a measured value
LONGEST: Final = 70


def blocks(result: StudyResult) -> list[Block]:
    """Each claim with what was measured and what is wanted."""
    claims = result.claims
    if not claims:
        return []
    failed = [claim.claim for claim in claims if not claim.met]
    verdict = f"Not met: {text.listing(failed)}." if failed else "All are met."
    worded = any(isinstance(claim.measured, str) for claim in claims)
    columns = [
        TableColumn("Claim"),
        TableColumn("Measured", number=not worded, wide=worded),
        wide_column("Wanted"),
        TableColumn("Verdict"),
    ]
    rows = [
        [
            claim.claim,
            _measured(claim.measured),
            claim.wanted,
            "✓ met" if claim.met else "✗ not met",
        ]
        for claim in claims
    ]
    marks = ["good" if claim.met else "bad" for claim in claims]
    caption = (
        "The claims of the study, from its [expect] table, against the measured"
        f" values. {verdict}"
    )
    return [Table(columns, rows, caption, marks)]


def _measured(value: float | str) -> str:
    if isinstance(value, str):
        return shorten(value, LONGEST)
    return text.trimmed(value, 5)


CHAPTER: Final = Chapter("claims", "Claims", blocks)
