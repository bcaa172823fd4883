"""The subcommand `oed run`: a whole study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands.options import (
    AllowCode,
    Quiet,
    Seed,
    StudyPath,
    Verbose,
)
from pkm_studies.commands.study_file import load_for
from pkm_studies.stages.outcome import report_outcome


def run(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the results [out/NAME]."),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Run a study: design, identification, accuracy, report."""
    from pkm_studies.notebook import display

    loaded, folder = load_for(study, allow_code, out)
    from pkm_studies import pipeline  # only now: errors of input come at once

    with display.progress(quiet=quiet) as progress:
        result = pipeline.run(loaded, folder, seed=seed, progress=progress)
    return report_outcome(result, folder, quiet, verbose=verbose)
