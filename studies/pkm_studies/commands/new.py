"""Subcommands before anything runs: new, import, check."""

import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from pkm_studies import console
from pkm_studies.base import InputError
from pkm_studies.commands.options import AllowCode
from pkm_studies.console import BAD_INPUT, DONE, FAILED
from pkm_studies.plugins import project_plugins
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
    origin = Origin(Path(), Consent.from_call(allow_code=allow_code))
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
        consent=Consent.from_call(allow_code=allow_code),
    )
    for statement in imported.statements:
        print(statement)
    arguments = ["run", str(path), "--out", str(out / "report")]
    print(f"Study: {path}; then: oed {shlex.join(arguments)}")
    return 0


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

    permission = Consent.from_call(allow_code=allow_code)
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
