"""The report of a campaign: what its cases show, by combination."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import oed
from pkm_campaign import function_report, machine_report
from pkm_campaign.tables import Campaign
from pkm_reports.blocks import Code, Items, Section
from pkm_reports.page import Content, assembled
from pkm_reports.report import write_document

if TYPE_CHECKING:
    import pandas as pd


def write_report(
    campaign: Campaign, summary: pd.DataFrame, out: Path
) -> tuple[Path, ...]:
    """Write `report.html` and `report.pdf` of a campaign's summary; their paths."""
    rows = _rows(summary)
    count = sum(int(row["cases"]) for row in rows)
    if campaign.varied is None:
        machine, asked = "", f"{count} cases of {campaign.case}"
        chapters = function_report.chapters(campaign, rows)
    else:
        machine = campaign.varied.machine.model
        asked = f"{count} virtual machines of {campaign.varied.name}"
        chapters = machine_report.chapters(campaign, rows)
    blocks = [Items(sentences(campaign, summary))]
    content = Content(
        title=campaign.title or f"Campaign {campaign.name}",
        question=f"What do {asked} show?",
        study=campaign.name,
        machine=machine,
        foot=f"{campaign.name} · pkm-oed {oed.__version__}",
        answer=[Section("found", "What the cases show", blocks)],
        chapters=chapters,
        appendix=[Section("file", "Campaign file", [Code(campaign.text)])],
    )
    return write_document(assembled(content), out, "report")


def sentences(campaign: Campaign, summary: pd.DataFrame) -> list[str]:
    """What a summary says, the most important first."""
    rows = _rows(summary)
    if campaign.varied is None:
        return function_report.sentences(rows)
    return machine_report.sentences(campaign, rows)


def _rows(summary: pd.DataFrame) -> machine_report.Rows:
    return [{str(k): v for k, v in row.items()} for row in summary.to_dict("records")]
