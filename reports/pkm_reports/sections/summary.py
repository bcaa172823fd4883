"""What stands before the first chapter: the answer in five sentences, and the claims."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Items,
    Notice,
    Paragraph,
    Table,
    TableColumn,
    transposed,
)


def blocks(result: Mapping[str, Any]) -> list[Block]:
    """Headline sentences, claims, and a pointer to the warnings if there are any."""
    headline = [words.pretty(line) for line in result.get("headline") or []]
    made: list[Block] = (
        [Items(headline, numbered=True)]
        if headline
        else [Paragraph("No headline was computed.")]
    )
    warnings = result.get("warnings") or []
    if warnings:
        told = "is 1 warning" if len(warnings) == 1 else f"are {len(warnings)} warnings"
        made.append(
            Notice(
                f"There {told}: see the last chapter. The first:"
                f" {words.sentence(warnings[0])}"
            )
        )
    return made + _claims(result.get("claims") or [])


def _claims(claims: list[Mapping[str, Any]]) -> list[Block]:
    if not claims:
        return [Paragraph("This study makes no claims to check.")]
    failed = [str(c["claim"]) for c in claims if not c["met"]]
    verdict = f"Not met: {words.listing(failed)}." if failed else "All are met."
    rows = transposed(
        [
            [str(c["claim"]) for c in claims],
            [_measured(c["measured"]) for c in claims],
            [str(c["wanted"]) for c in claims],
            ["✓ met" if c["met"] else "✗ not met" for c in claims],
        ]
    )
    told = any(isinstance(c["measured"], str) for c in claims)
    measured = TableColumn("Measured", number=not told, wide=told)
    columns = [
        TableColumn("Claim"),
        measured,
        TableColumn("Wanted", wide=True),
        TableColumn("Verdict"),
    ]
    marks = ["good" if c["met"] else "bad" for c in claims]
    caption = (
        f"What the study claims in its [expect] table, against what came out. {verdict}"
    )
    return [Table(columns, rows, caption, marks)]


def _measured(value: Any) -> str:
    return words.cut(value) if isinstance(value, str) else words.plain(value, 5)
