"""Subcommands on stored results: report, compare, history, adjust, compensate."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands.options import (
    AllowCode,
    MachineStudy,
    ResultFolder,
    StoredResult,
)
from pkm_studies.console import DONE, FAILED
from pkm_studies.user_code import Consent


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...",
            help="Folder with a result.json; several are put side by side.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for a comparison of several results."),
    ] = Path("out/comparison"),
    full: Annotated[
        bool, typer.Option("--full", help="A PDF with all that the HTML has.")
    ] = False,
) -> int:
    """Write HTML and PDF again from result.json, or a comparison of several results."""
    from pkm_studies import files, result_folder

    if len(folders) == 1:
        paths = result_folder.write_report(folders[0], full=full)
    else:
        from pkm_studies.sessions import write_comparison

        files.check_writable(out)
        paths = write_comparison(folders, out)
    for path in paths:
        print(f"Report: {path}")
    return DONE


def compare(before: ResultFolder, after: ResultFolder) -> int:
    """Compare two sessions of one machine: what changed, and by how much."""
    from pkm_studies import sessions

    compared = sessions.compare(before, after)
    for sentence in compared.sentences:
        print(sentence)
    return DONE if compared.is_trusted else FAILED


def history(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...", help="Results of one machine, or folders of results."
        ),
    ],
    limit: Annotated[
        str,
        typer.Option(
            metavar="z_um=30,...",
            help="Rms errors at which to calibrate again [twice the present ones].",
        ),
    ] = "",
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Show how a machine drifts over its sessions, and when to calibrate again."""
    from pkm_studies.sessions import machine_history

    permission = Consent.of_call(allow_code=allow_code)
    report = machine_history(folders, limit, study, permission)
    for sentence in report.sentences:
        print(sentence)
    return DONE if report.is_trusted else FAILED


def adjust(
    folder: StoredResult,
    wanted: Annotated[
        str,
        typer.Option(
            metavar="z_um=30,...",
            help="Rms errors by which components count, and only these [by length].",
        ),
    ] = "",
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Choose what to adjust at the machine, by how much, and what it brings."""
    from pkm_studies.sessions import adjust_folder, adjustment_sentences

    permission = Consent.of_call(allow_code=allow_code)
    section, paths = adjust_folder(
        folder, wanted=wanted, study_file=study, consent=permission
    )
    for line in adjustment_sentences(section):
        print(line)
    for path in paths:
        print(f"Written: {path}")
    return DONE


Commands = Annotated[
    int | None,
    typer.Option(metavar="N", help="Largest number of commands of a table [5000]."),
]
FirmwareVersion = Annotated[
    str | None,
    typer.Option(
        metavar="VERSION",
        help="Version of the controller's firmware, as in 2.0.5 [that of the import].",
    ),
]


def compensate(
    folder: StoredResult,
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="A format of `oed list formats`, or path/to/file.py:attribute.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File to write [DIR/compensation.*]."),
    ] = None,
    study: MachineStudy = None,
    commands: Commands = None,
    firmware: FirmwareVersion = None,
    adjusted: Annotated[
        bool, typer.Option(help="For the machine after the lines of `oed adjust`.")
    ] = False,
    force: Annotated[bool, typer.Option(help="Write a bad fit as well.")] = False,
    allow_code: AllowCode = False,
) -> int:
    """Write what the controller reads: parameters, tables, measuring poses."""
    from pkm_studies.compensation import export_folder

    written = export_folder(
        folder,
        to,
        out=out,
        study_file=study,
        force=force,
        commands=commands,
        firmware=firmware,
        adjusted=adjusted,
        consent=Consent.of_call(allow_code=allow_code),
    )
    for path in written.paths:
        print(f"Compensation: {path}")
    for sentence in written.sentences:
        print(f"{sentence[0].upper()}{sentence[1:]}.")
    return DONE
