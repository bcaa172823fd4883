"""The subcommand `oed import`: files of another program in, a study with readings out."""

import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from pkm_studies.commands.options import AllowCode
from pkm_studies.plugins import project_plugins
from pkm_studies.user_code import Consent


def import_files(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help=f"{', '.join(project_plugins('importers'))}, or MY.py."
        ),
    ],
    paths: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Its files.")],
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for study and readings.")
    ],
    name: Annotated[
        str | None, typer.Option(help="Name of the study [that of the first file].")
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            help="A machine of `oed list machines`, MY.py, or a study with it."
        ),
    ] = None,
    column_map: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="MAP.toml",
            help="Which column is what; kept for next time.",
        ),
    ] = None,
    mesh: Annotated[
        Literal["hold-out", "readings"],
        typer.Option(help="Heights of bed meshes are predicted, or fitted as well."),
    ] = "hold-out",
    allow_code: AllowCode = False,
) -> int:
    """Make a study with readings from files of another program."""
    from pkm_studies import importers

    path, imported = importers.import_files(
        kind,
        paths,
        out,
        name=name,
        machine=machine,
        column_map=column_map,
        mesh=mesh,
        consent=Consent.of_call(allow_code=allow_code),
    )
    for statement in imported.statements:
        print(statement)
    arguments = ["run", str(path), "--out", str(out / "report")]
    print(f"Study: {path}; then: oed {shlex.join(arguments)}")
    return 0
