"""The subcommand `oed check`: studies and readings before anything runs."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies import console
from pkm_studies.base import InputError
from pkm_studies.commands.options import AllowCode
from pkm_studies.console import BAD_INPUT, DONE, FAILED


def check(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Studies, readings, and machines of your own (my.py).",
        ),
    ],
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            help="Draw the machine of the first file at its home pose: png, svg or pdf.",
        ),
    ] = None,
    allow_code: AllowCode = False,
) -> int:
    """Check studies, and readings against what they predict; run nothing."""
    from pkm_studies.commands import checks
    from pkm_studies.user_code import Consent

    permission = Consent.of_call(allow_code=allow_code)
    code = DONE
    if picture is not None:
        print(f"Picture: {checks.draw_machine(paths[0], picture, permission)}")
    for path, verdict in checks.check(paths, permission):
        if isinstance(verdict, InputError):
            console.print_error(str(verdict))
            code = BAD_INPUT
            continue
        print(f"{path}: {verdict.content}")
        for sentence in [*verdict.findings, *verdict.remarks]:
            print(f"  {sentence}")
        if verdict.findings:
            code = max(code, FAILED)
    return code
