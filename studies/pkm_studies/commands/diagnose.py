"""The subcommand `oed diagnose`: what causes the gap."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands.options import (
    AllowCode,
    OutFolder,
    Quiet,
    Seed,
    StudyPath,
    Verbose,
)
from pkm_studies.commands.study_file import load_for
from pkm_studies.stages.outcome import report_outcome


def diagnose(
    study: StudyPath,
    out: OutFolder,
    readings: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="CSV",
            help="The readings [those of the study]; again for a further file.",
            show_default=False,
        ),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Earlier diagnosis: its readings count as well.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Find what causes the gap between model and machine: which effect, and where."""
    from pkm_studies.notebook import display

    loaded, folder = load_for(study, allow_code, out)
    from pkm_studies import pipeline

    with display.progress(quiet=quiet) as progress:
        result = pipeline.diagnose(
            loaded, readings or None, folder, after=after, seed=seed, progress=progress
        )
    return report_outcome(result, folder, quiet, verbose=verbose)
