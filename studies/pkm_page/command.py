"""The subcommand `oed serve`."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands import AllowCode, Wanted
from pkm_studies.console import DONE
from pkm_studies.user_code import Consent


def serve(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY|DIR",
            help="A study, a result, or a folder of studies and results.",
        ),
    ],
    readings: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Readings file [poses.csv of the results]."),
    ] = None,
    wanted: Wanted = "",
    host: Annotated[
        str, typer.Option(help="Address to serve on; others than this need a token.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port; 0: a free one.")
    ] = 8765,
    source: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="SOURCE",
            help="Readings from a file, a folder, tcp://HOST:PORT or serial:DEVICE,BAUD.",
        ),
    ] = "",
    pattern: Annotated[
        str,
        typer.Option(
            metavar="REGEX", help="Columns in a line, as (?P<length_mm>[-+0-9.]+)."
        ),
    ] = "",
    take: Annotated[
        bool, typer.Option("--take", help="Take what arrives without a key.")
    ] = False,
    allow_code: AllowCode = False,
) -> int:
    """Open the page at the machine: measure, see what is known, decide."""
    from pkm_page import PageOptions
    from pkm_page import serve as serve_page

    options = PageOptions(
        readings,
        wanted,
        source,
        pattern,
        take,
        Consent.from_call(allow_code=allow_code),
    )

    def say(address: str) -> None:
        print(f"Page: {address}  (Ctrl-C ends it)", flush=True)

    serve_page(target, options, host, port, say)
    return DONE
