"""Campaigns: a product of settings and seeds over virtual machines of one study.

Campaign       what a file of a campaign states
load_campaign  reads it
run_cases      computes the cases that are missing from a folder
Job            a case, and the file of its row
Row            what is stored of a case: plain JSON
run_jobs       computes and stores rows of any function, on processes or a cluster
read_row       a stored row
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_campaign.jobs import Job, Row, read_row, run_jobs
    from pkm_campaign.runner import run_cases
    from pkm_campaign.tables import Campaign, load_campaign
else:
    # imported when first used: `oed --help` imports the subcommand
    __getattr__ = door(__name__)
