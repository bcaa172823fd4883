"""The subcommand `oed history`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base.user_code import consent
from pkm_studies.commands.options import AllowCode, MachineStudy
from pkm_studies.stages.outcome import DONE, FAILED


def history(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...",
            help="Results of one machine, or folders of results.",
            show_default=False,
        ),
    ],
    limit: Annotated[
        str,
        typer.Option(
            metavar="z_um=30,...",
            help="Rms errors at which to calibrate again [twice the present ones].",
        ),
    ] = "",
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Show how a machine drifts over its sessions, and when to calibrate again."""
    from pkm_studies.sessions import history as histories

    given = consent(allow_code=allow_code)
    report = histories.history(folders, limit, study, given)
    for sentence in report.sentences:
        print(sentence)
    return DONE if report.is_trusted else FAILED
