"""Drafts of a study for a machine and an instrument, with open places for the user.

write_draft         writes the draft of a study, as `oed new` does
StartingModel       a machine to start from, with its numbers in the study
prediction_table    the workspace of a draft, where accuracy counts
read_time           seconds of a time as one says it: `two days`
format_numbers      numbers in SI as a draft writes them
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.drafts.axis_lines import format_numbers, prediction_table
    from pkm_studies.drafts.drafts import StartingModel, write_draft
    from pkm_studies.drafts.time_budget import read_time
else:
    __getattr__ = door(__name__)
