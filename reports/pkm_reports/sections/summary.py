"""What stands before the first chapter: the answer in a few sentences, and the claims."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import Claim, StudyResult
from oed.text import shorten
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Items,
    Notice,
    Paragraph,
    Table,
    TableColumn,
    wide_column,
)
from pkm_reports.sections import acceptance

#: characters of a measured value
LONGEST: Final = 70


def blocks(result: StudyResult) -> list[Block]:
    """Headline sentences, a pointer to the warnings if there are any, and claims."""
    alarms = [] if result.goodness is None else result.goodness.findings
    lines = [line for line in result.headline if line not in alarms]
    if result.verification is not None:
        lines = [acceptance.verdict(result.verification), *lines]
    headline = [text.with_symbols(line) for line in lines]
    opening: list[Block] = [Notice(text.with_symbols(alarm)) for alarm in alarms]
    opening.append(Items(headline, numbered=True))
    if not headline:
        opening[-1] = Paragraph("No headline was computed.")
    if result.warnings:
        opening.append(Notice(_warning(result.warnings)))
    return opening + _claims(result.claims)


def _warning(warnings: Sequence[str]) -> str:
    verb = "is" if len(warnings) == 1 else "are"
    count = text.count(len(warnings), "warning")
    first = text.sentence(warnings[0])
    return f"There {verb} {count}: see the last chapter. The first: {first}"


def _claims(claims: Sequence[Claim]) -> list[Block]:
    if not claims:
        return [Paragraph("This study makes no claims to check.")]
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
