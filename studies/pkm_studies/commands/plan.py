"""The subcommand `oed plan`: which measurements, in which order."""

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


def plan(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the results [out/NAME-plan]."),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT_DIR",
            help="Result of an earlier session: plan the stages after it.",
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Plan which measurements to do, in which order; read and fit nothing."""
    from pkm_studies.notebook import display

    loaded, folder = load_for(study, allow_code, out, "-plan")
    from pkm_studies import pipeline

    with display.progress(quiet=quiet) as progress:
        result = pipeline.plan(
            loaded, folder, after=after, seed=seed, progress=progress
        )
    lines = []
    if not quiet and result.plan is not None:
        lines = display.plan_lines(result.plan, verbose=verbose)
    return report_outcome(result, folder, quiet, verbose=verbose, above=lines)
