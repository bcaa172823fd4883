"""Campaigns: a product of settings and seeds over virtual machines of one study.

Campaign       what a file of a campaign states
load_campaign  reads it
run_cases      computes the cases that are missing from a folder
Job            a case, and the file of its row
Row            what is stored of a case: plain JSON
run_jobs       computes and stores rows of any function, on processes or a cluster
read_row       a stored row
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oed.base.lazy import attributes

if TYPE_CHECKING:
    from pkm_campaign.jobs import Job, Row, read_row, run_jobs
    from pkm_campaign.runner import run_cases
    from pkm_campaign.tables import Campaign, load_campaign

__all__ = [
    "Campaign",
    "Job",
    "Row",
    "load_campaign",
    "read_row",
    "run_cases",
    "run_jobs",
]

# imported when first used: `oed --help` imports the subcommand
__getattr__ = attributes(
    __name__,
    {
        "jobs": ("Job", "Row", "read_row", "run_jobs"),
        "runner": ("run_cases",),
        "tables": ("Campaign", "load_campaign"),
    },
)
