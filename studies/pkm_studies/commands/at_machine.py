"""The subcommand `oed next`."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base import InputError
from pkm_studies.commands.options import AllowCode, StudyPath, Wanted
from pkm_studies.console import DONE, FAILED
from pkm_studies.user_code import Consent


def next_reading(
    study: StudyPath,
    readings: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Readings so far.")
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="A diagnosis: the readings that separate its answers."
        ),
    ] = None,
    wanted: Wanted = "",
    follow: Annotated[
        bool, typer.Option("--follow", help="Stay open, and follow the file.")
    ] = False,
    allow_code: AllowCode = False,
) -> int:
    """Advise at the machine: the best next reading, when to stop; the next visit of a diagnosis."""
    from pkm_studies import shipped
    from pkm_studies.study import Study

    loaded = Study.load(
        shipped.study_path(study), Consent.of_call(allow_code=allow_code)
    )
    if after is not None:
        _check_alone(after, readings, wanted, follow=follow)
        from pkm_studies.sessions import visit_lines

        print("\n".join(visit_lines(loaded, study, after)))
        return DONE
    if readings is None:
        raise _no_readings()
    from pkm_studies.sessions import Adviser

    adviser = Adviser(loaded, wanted)
    if not follow:
        advice = adviser.advise(readings)
        print("\n".join(adviser.advice_sentences(advice)))
        return FAILED if advice.objections else DONE
    for lines in adviser.watch(readings):
        print("\n".join([*lines, ""]), flush=True)
    return 0


def _check_alone(
    after: Path, readings: Path | None, wanted: str, *, follow: bool
) -> None:
    """Raises InputError where options of the next reading go with a diagnosis."""
    if readings is None and not wanted and not follow:
        return
    raise InputError(
        "a diagnosis has its own readings: --readings, --wanted and --follow are of the"
        " next single reading",
        "give --after alone, or leave it out",
        field="--after",
        value=str(after),
    )


def _no_readings() -> InputError:
    return InputError(
        "there is nothing to advise from",
        "give --readings FILE.csv, or --after DIR with the folder of a diagnosis",
        field="--readings",
    )
