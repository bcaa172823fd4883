"""The subcommand `oed compensate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base import console
from pkm_studies.base.user_code import consent
from pkm_studies.commands.options import AllowCode, MachineStudy

DONE, FAILED = 0, 1

Commands = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Largest number of commands of a table [5000].",
        show_default=False,
    ),
]
FirmwareVersion = Annotated[
    str | None,
    typer.Option(
        metavar="VERSION",
        help="Version of the controller's firmware, as in 2.0.5 [that of the import].",
        show_default=False,
    ),
]


def compensate(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder with a result.json.", show_default=False
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="A format of `oed list formats`, or path/to/file.py:attribute.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File to write [DIR/compensation.*]."),
    ] = None,
    study: MachineStudy = None,
    commands: Commands = None,
    firmware: FirmwareVersion = None,
    adjusted: Annotated[
        bool, typer.Option(help="For the machine after the lines of `oed adjust`.")
    ] = False,
    force: Annotated[bool, typer.Option(help="Write a bad fit as well.")] = False,
    allow_code: AllowCode = False,
) -> int:
    """Write what the controller reads: parameters, tables, measuring poses."""
    from pkm_studies.compensation import export
    from pkm_studies.stages.corrected import table_grid

    try:
        written = export.export_folder(
            folder,
            to,
            out=out,
            study_file=study,
            force=force,
            commands=table_grid.COMMANDS if commands is None else commands,
            firmware=firmware,
            adjusted=adjusted,
            consent=consent(allow_code=allow_code),
        )
    except export.BadFitError as error:
        console.print_error(str(error))
        return FAILED
    for path in written.paths:
        print(f"Compensation: {path}")
    for sentence in written.sentences:
        print(f"{sentence[0].upper()}{sentence[1:]}.")
    return DONE
