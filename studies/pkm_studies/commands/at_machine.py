"""Subcommands at the machine: next and serve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base.console import DONE, FAILED
from pkm_studies.base.user_code import consent
from pkm_studies.commands.options import AllowCode, StudyPath

Wanted = Annotated[
    str,
    typer.Option(
        metavar="z_um=30,...",
        help="Rms errors at which to stop [the study's]; plan: those of its plan.",
    ),
]


def next_reading(
    study: StudyPath,
    readings: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Readings so far.", show_default=False),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="A diagnosis: the readings that separate its answers.",
            show_default=False,
        ),
    ] = None,
    wanted: Wanted = "",
    follow: Annotated[
        bool, typer.Option("--follow", help="Stay open, and follow the file.")
    ] = False,
    allow_code: AllowCode = False,
) -> int:
    """Advise at the machine: the best next reading, when to stop; the next visit of a diagnosis."""
    from pkm_studies.sessions import next_visit
    from pkm_studies.study import load, shipped

    loaded = load(shipped.study_path(study), consent(allow_code=allow_code))
    if after is not None:
        next_visit.check_alone(after, readings, wanted, follow=follow)
        print("\n".join(next_visit.lines(loaded, study, after)))
        return DONE
    if readings is None:
        raise next_visit.no_readings()
    from pkm_studies.sessions import next_reading as advice
    from pkm_studies.sessions.next_sentences import sentences

    adviser = advice.Adviser(loaded, wanted)
    if not follow:
        known = adviser.advise(readings)
        print("\n".join(sentences(adviser, known)))
        return FAILED if known.objections else DONE
    for lines in advice.watch(adviser, readings):
        print("\n".join([*lines, ""]), flush=True)
    return 0


def serve(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY|DIR",
            help="A study, a result, or a folder of studies and results.",
            show_default=False,
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
    from pkm_studies.page import serve as page

    options = page.PageOptions(
        readings, wanted, source, pattern, take, consent(allow_code=allow_code)
    )

    def say(address: str) -> None:
        print(f"Page: {address}  (Ctrl-C ends it)", flush=True)

    page.serve(target, options, host, port, say)
    return DONE
