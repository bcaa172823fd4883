"""The subcommand `oed forecast`: a grid of measured errors becomes the controller's table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from oed.base import own_files
from pkm_studies.base import console
from pkm_studies.commands.options import AllowCode, Seed, StudyPath
from pkm_studies.commands.study_file import load_for
from pkm_studies.stages.outcome import DONE, FAILED


def forecast(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the results; an estimate there is known [out/NAME-forecast].",
        ),
    ] = None,
    readings: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="Measured nodes: write the table. Without: plan the nodes.",
        ),
    ] = None,
    seed: Seed = None,
    allow_code: AllowCode = False,
) -> int:
    """Plan the nodes of forecast compensation, or make the table of measured ones."""
    loaded, folder = load_for(study, allow_code, out, "-forecast")
    from pkm_studies import pipeline
    from pkm_studies.results import claims
    from pkm_studies.stages.forecast.words import sentences

    result = pipeline.forecast(loaded, folder, readings=readings, seed=seed)
    for sentence in sentences(result.forecast):
        print(sentence)
    name, words = ("forecast_nodes.csv", "To fill in")
    if result.forecast is not None and result.forecast.readings:
        name, words = ("forecast_table.csv", "Table")
    print(f"{words}: {own_files.latest(folder / name)}")
    failing = [
        claims.failure(claim, loaded.path.name)
        for claim in result.claims
        if not claim.met
    ]
    for sentence in failing:
        console.print_error(sentence)
    return FAILED if failing else DONE
