"""Subcommands on stored results: report, compare, history, adjust, compensate, verify."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base import InputError
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

    permission = Consent.from_call(allow_code=allow_code)
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

    permission = Consent.from_call(allow_code=allow_code)
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
        consent=Consent.from_call(allow_code=allow_code),
    )
    for path in written.paths:
        print(f"Compensation: {path}")
    for sentence in written.sentences:
        print(f"{sentence[0].upper()}{sentence[1:]}.")
    return DONE


Uncertainty = Annotated[
    str,
    typer.Option(
        metavar="z_um=2,...",
        help="Standard uncertainty of a measured error [by the study's instrument].",
    ),
]


def verify(
    folder: StoredResult,
    readings: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="The filled-in file, or readings along runs: judge them. Without: plan.",
        ),
    ] = None,
    promise: Annotated[
        str,
        typer.Option(
            metavar="z_um=30,...", help="Rms errors to confirm [the predicted ones]."
        ),
    ] = "",
    uncertainty: Uncertainty = "",
    power: Annotated[
        float, typer.Option(min=0.1, max=0.999, help="Power that is asked for.")
    ] = 0.9,
    poses: Annotated[int, typer.Option(min=1, max=200, help="Poses at most.")] = 12,
    planned: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            metavar="RESULT_DIR",
            help="Plan with effects: compare with what it says of a healthy machine.",
        ),
    ] = None,
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Plan the acceptance test of a compensated machine, or judge its readings."""
    from pkm_studies import acceptance

    permission = Consent.from_call(allow_code=allow_code)
    if readings is not None:
        _check_judged(promise, uncertainty, planned)
        return _judge(folder, readings, study, permission)
    section, path = acceptance.plan_folder(
        folder,
        promised=promise,
        uncertainty=uncertainty,
        power=power,
        most=poses,
        study_file=study,
        consent=permission,
        planned=planned,
    )
    print(*acceptance.plan_sentences(section), sep="\n")
    if min(demand.power for demand in section.components.values()) < power:
        print(
            f"{len(section.poses)} poses do not reach the power {power:g}: allow more by"
            " --poses, or measure more accurately (--uncertainty)."
        )
    print(f"To fill in: {path}")
    return DONE


def _check_judged(promise: str, uncertainty: str, planned: Path | None) -> None:
    """Raises InputError where what a test is planned with goes with its readings."""
    options = {
        "--promise": promise,
        "--uncertainty": uncertainty,
        "--plan": str(planned or ""),
    }
    for name, value in options.items():
        if value:
            raise InputError(
                "limits are those of the planned test, and --readings changes none",
                "give it without --readings, when the test is planned",
                field=name,
                value=value,
            )


def _judge(
    folder: Path, readings: Path, study: Path | None, permission: Consent
) -> int:
    """Judge a filled-in test, or compare readings along runs with the prediction."""
    from pkm_studies import acceptance, csv_table

    if "setup" in csv_table.read(readings).header:
        check = acceptance.check_folder(folder, readings, study, permission)
        print(*acceptance.check_sentences(check), sep="\n")
        return DONE if check.passed else FAILED
    verdict = acceptance.judge_folder(folder, readings)
    print(*acceptance.verdict_sentences(verdict), sep="\n")
    return DONE if verdict.passed else FAILED
