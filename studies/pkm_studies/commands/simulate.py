"""The subcommand `oed simulate`: readings of a virtual machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands.options import (
    AllowCode,
    StudyPath,
)
from pkm_studies.commands.study_file import load
from pkm_studies.stages.outcome import DONE


def simulate(
    study: StudyPath,
    out: Annotated[
        Path,
        typer.Option(
            metavar="READINGS.csv", help="File for the readings.", show_default=False
        ),
    ],
    allow_code: AllowCode = False,
) -> int:
    """Write readings of a virtual machine, and its truth in a second file."""
    from pkm_studies.base import files

    files.check_new(out)
    loaded = load(study, allow_code)
    files.check_writable(out.parent)
    from pkm_studies import pipeline

    readings, truth = pipeline.simulate(loaded, out)
    print(f"Readings: {readings}\nTruth: {truth}")
    return DONE
