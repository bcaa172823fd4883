"""The subcommand `oed adjust`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base import console
from pkm_studies.base.user_code import consent
from pkm_studies.commands.options import AllowCode, MachineStudy

DONE, FAILED = 0, 1


def adjust(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder with a result.json.", show_default=False
        ),
    ],
    wanted: Annotated[
        str,
        typer.Option(
            metavar="z_um=30,...",
            help="Rms errors by which components count, and only these [by length].",
        ),
    ] = "",
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Choose what to adjust at the machine, by how much, and what it brings."""
    from pkm_studies.compensation.export import BadFitError
    from pkm_studies.sessions import adjustment

    given = consent(allow_code=allow_code)
    try:
        section, paths = adjustment.adjust_folder(
            folder, wanted=wanted, study_file=study, consent=given
        )
    except BadFitError as error:
        console.print_error(str(error))
        return FAILED
    for sentence in adjustment.sentences(section):
        print(sentence)
    for path in paths:
        print(f"Written: {path}")
    return DONE
