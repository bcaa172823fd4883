"""The subcommand `oed history`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


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
    study: Annotated[
        Path | None,
        typer.Option(
            metavar="STUDY", help="The study, where its machine is a file of yours."
        ),
    ] = None,
) -> int:
    """Show how a machine drifts over its sessions, and when to calibrate again."""
    from pkm_studies import history as histories

    for sentence in histories.history(folders, limit, study):
        print(sentence)
    return 0
