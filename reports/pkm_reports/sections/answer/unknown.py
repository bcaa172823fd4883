"""What the readings leave unknown, and what would bring it back."""

from __future__ import annotations

from typing import Final

from oed.result import IdentifiabilityFinding, IdentifiabilitySection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Items, Paragraph
from pkm_reports.sections.identifiability import lost_count

#: remedies of a finding that are named
MOST: Final = 4


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    return "What stays unknown"


def blocks(result: StudyResult) -> list[Block]:
    """Lost and weak directions, each with its remedies; where nothing is, that."""
    section = result.identifiability
    if section is None:
        return []
    findings = [f for f in section.words if f.kind in ("lost", "weak")]
    content: list[Block] = [Paragraph(_count(section))]
    if findings:
        content.append(Items([_finding(finding) for finding in findings]))
    return content


def _count(section: IdentifiabilitySection) -> str:
    lost = lost_count(section)
    parameters = text.count(section.n, "unknown")
    if not lost:
        return f"The readings determine all of the {parameters}."
    verb = "stays" if lost == 1 else "stay"
    directions = text.count(lost, "combination")
    return (
        f"The readings determine {section.rank} of {parameters}: {directions} of them"
        f" {verb} as uncertain as the tolerances."
    )


def _finding(finding: IdentifiabilityFinding) -> str:
    phrase = text.sentence(finding.text)
    if not finding.remedies:
        return phrase
    return f"{phrase} What helps: {'; '.join(finding.remedies[:MOST])}."
