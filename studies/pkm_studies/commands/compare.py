"""The subcommand `oed compare`: two sessions of one machine."""

from __future__ import annotations

from pkm_studies.commands.options import (
    ResultFolder,
)
from pkm_studies.stages.outcome import DONE, FAILED


def compare(before: ResultFolder, after: ResultFolder) -> int:
    """Compare two sessions of one machine: what changed, and by how much."""
    from pkm_studies.results import comparison

    compared = comparison.compare(before, after)
    for sentence in compared.sentences:
        print(sentence)
    return DONE if compared.is_trusted else FAILED
