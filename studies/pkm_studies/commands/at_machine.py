"""The subcommand `oed next`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base.console import DONE, FAILED
from pkm_studies.base.user_code import consent
from pkm_studies.commands.options import AllowCode, StudyPath, Wanted


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
