"""Options that several subcommands have."""

from pathlib import Path
from typing import Annotated

import typer

AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Run Python files that the study names, now and while they are unchanged.",
    ),
]

StudyPath = Annotated[
    Path,
    typer.Argument(
        metavar="STUDY", help="A study file, or the name of a shipped study."
    ),
]
OptionalStudy = Annotated[
    Path | None,
    typer.Argument(
        metavar="STUDY",
        help="A study file, or the name of a shipped study [--machine].",
    ),
]
OwnMachine = Annotated[
    str | None,
    typer.Option(
        help="In place of a study: a machine of `oed list machines`, or MY.py."
    ),
]
OwnNumbers = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME_UNIT=NUMBER",
        help="A number of that machine, as it has it now; again for a further one.",
    ),
]
MachineStudy = Annotated[
    Path | None,
    typer.Option(
        metavar="STUDY", help="The study, where its machine is a file of yours."
    ),
]
OutFolder = Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")]
ResultFolder = Annotated[Path, typer.Argument(metavar="DIR", help="A result.")]
StoredResult = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder with a result.json.")
]
Wanted = Annotated[
    str,
    typer.Option(
        metavar="z_um=30,...",
        help="Rms errors at which to stop [the study's]; plan: those of its plan.",
    ),
]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed in place of the study's.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", help="Print only errors and failing claims.")
]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", help="Print every sentence and claim, not 25 lines."),
]
