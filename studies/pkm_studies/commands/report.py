"""The subcommand `oed report`: pages from stored results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.stages.outcome import DONE


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...",
            help="Folder with a result.json; several are put side by side.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for a comparison of several results."),
    ] = Path("out/comparison"),
) -> int:
    """Write HTML and PDF again from result.json, or a comparison of several results."""
    from pkm_studies.base import files
    from pkm_studies.results import stored_result

    if len(folders) == 1:
        paths = stored_result.write_report(folders[0])
    else:
        files.check_writable(out)
        paths = stored_result.write_comparison(folders, out)
    for path in paths:
        print(f"Report: {path}")
    return DONE
