"""The subcommand `oed new`: a study to start from."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base import InputError
from pkm_studies.commands.options import AllowCode
from pkm_studies.user_code import Consent, Origin


def new(
    name: Annotated[
        str | None, typer.Argument(help="Name of the study [the machine's].")
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            help="A machine of `oed list machines`, MY.py, MJCF (.xml) or URDF."
        ),
    ] = None,
    loops: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Loops that close a URDF.")
    ] = None,
    instrument: Annotated[
        str | None,
        typer.Option(
            help="An instrument of `oed list instruments` [one that can read it]."
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            "--from", metavar="STUDY", help="A study of `oed list studies` to copy."
        ),
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(
            help="Time at the machine, as `two days` or `90 min`: as many readings."
        ),
    ] = None,
    allow_code: AllowCode = False,
) -> int:
    """Write a study to start from: a commented one, or a copy of a shipped one."""
    # The study will name the files: they lie where a study's files may lie.
    origin = Origin(Path(), Consent.of_call(allow_code=allow_code))
    if source is not None:
        path = _copied(name, source, machine, instrument, time)
    else:
        path = _drafted(name, machine, loops, instrument, time, origin)
    from pkm_studies.tables import TO_MEASURE

    first = "edit it"
    if TO_MEASURE in path.read_text(encoding="utf-8"):
        first = f'write your numbers where it says "{TO_MEASURE}"'
    print(f"Study: {path}; {first}, then: oed run {shlex.quote(str(path))}")
    return 0


def _copied(name: str | None, source: str, *others: str | None) -> Path:
    """A copy of a shipped study. Raises InputError for options of a new one."""
    if any(other is not None for other in others):
        raise InputError(
            "--from copies a whole study",
            "leave out --machine, --instrument and --time, or leave out --from",
        )
    if name is None:
        raise InputError("a copy needs a name", "oed new NAME --from STUDY")
    from pkm_studies import shipped

    return shipped.copy(name, source, Path())


def _drafted(
    name: str | None,
    machine: str | None,
    loops: Path | None,
    instrument: str | None,
    time: str | None,
    origin: Origin,
) -> Path:
    if machine is None:
        raise InputError(
            "it is not said what to start from",
            "give --machine, a name or a file of your own, or --from STUDY",
        )
    from pkm_studies.drafts import StartingModel, read_time, write_draft

    seconds = None if time is None else read_time(time)
    model = StartingModel.named(machine, origin, loops)
    for sentence in model.sentences:
        print(f"{sentence[0].upper()}{sentence[1:]}.")
    if instrument is None:
        instrument, others = model.default_instrument(origin)
        print(f"Instrument: {instrument}; it can also be read by {', '.join(others)}")
    return write_draft(name, model, instrument, origin, seconds)
