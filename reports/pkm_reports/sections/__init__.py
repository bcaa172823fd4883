"""The chapters of the report, in order; each module has `ANCHOR`, `TITLE` and
`blocks(result)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pkm_reports.blocks import Section
from pkm_reports.sections import (
    accuracy,
    campaign,
    design,
    held_out,
    identifiability,
    identification,
    kappa,
    plan,
    posterior,
    record,
)
from pkm_reports.sections.gap import before as gap_before
from pkm_reports.sections.gap import diagnosis as gap

CHAPTERS: Final = (
    plan,
    design,
    kappa,
    identifiability,
    identification,
    posterior,
    accuracy,
    held_out,
    record,
)


def chapters(result: Mapping[str, Any]) -> list[Section]:
    """All chapters; one whose stage did not run says so in a sentence.

    A plan that was searched for has a chapter of its own, the first; the next then
    leaves its stages out. A diagnosis has one where there was one, before all others,
    and what the readings could find comes after it.
    """
    made = [(chapter, result) for chapter in CHAPTERS]
    if campaign.planned(result):
        made = [(campaign, result), (plan, {**result, "plan": None}), *made[1:]]
    if gap_before.present(result):
        made = [(gap_before, result), *made]
    if gap.present(result):
        made = [(gap, result), *made]
    return [
        Section(chapter.ANCHOR, chapter.TITLE, chapter.blocks(seen))
        for chapter, seen in made
    ]
