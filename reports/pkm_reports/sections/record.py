"""Chapters of the appendix: claims, key figures, and the record of what was computed."""

from typing import Final

from oed.result import StudyResult
from oed.text import shorten
from pkm_reports import text
from pkm_reports.blocks import Block, Chapter, Code, Paragraph, Table, TableColumn

MAX_VALUE_CHARACTERS: Final = 70  #: characters of a measured value


def _claims(result: StudyResult) -> list[Block]:
    claims = result.claims
    if not claims:
        return []
    failed = [claim.claim for claim in claims if not claim.met]
    verdict = f"Not met: {text.listing(failed)}." if failed else "All are met."
    worded = any(isinstance(claim.measured, str) for claim in claims)
    columns = [
        TableColumn("Claim"),
        TableColumn("Measured", number=not worded, wide=worded),
        TableColumn("Wanted", wide=True),
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
        return shorten(value, MAX_VALUE_CHARACTERS)
    return text.trimmed(value, 5)


CLAIMS: Final = Chapter("claims", "Claims", _claims)


def _record(result: StudyResult) -> list[Block]:
    """Everything needed to run the study again."""
    content: list[Block] = [_versions(result)]
    if result.study_text:
        content += [Paragraph("The study file:"), Code(result.study_text)]
    return content


def _versions(result: StudyResult) -> Table:
    rows = [
        ["study", result.study],
        ["seed", str(result.seed)],
        ["time", text.quantity(result.seconds, "s")],
        ["result schema", str(result.schema)],
        ["pkm-oed", result.version],
    ]
    others = {n: v for n, v in result.versions.items() if n != "pkm-oed"}
    rows += [[name, version] for name, version in others.items()]
    caption = "Seed and versions: the same ones give the same numbers."
    return Table([TableColumn("What"), TableColumn("Value", wide=True)], rows, caption)


RECORD: Final = Chapter("record", "Record", _record)
