"""The subcommand `oed identify`: the machine from readings."""

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


def identify(
    study: StudyPath,
    readings: Annotated[
        list[Path],
        typer.Option(
            metavar="CSV",
            help="The readings; again for a further file.",
            show_default=False,
        ),
    ],
    out: OutFolder,
    effects: Annotated[
        str | None,
        typer.Option(
            "--with",
            metavar="EFFECT,...",
            help="Effects to estimate together with the parameters.",
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Identify the machine from readings."""
    from pkm_studies.notebook import display

    loaded, folder = load_for(study, allow_code, out)
    from pkm_studies import pipeline

    with display.progress(quiet=quiet) as progress:
        result = pipeline.run(
            loaded,
            folder,
            seed=seed,
            progress=progress,
            readings=readings,
            effects=effects.replace(",", " ").split() if effects else (),
        )
    return report_outcome(result, folder, quiet, verbose=verbose)
