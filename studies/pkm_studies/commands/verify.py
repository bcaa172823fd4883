"""The subcommand `oed verify`."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.base import InputError
from pkm_studies.commands.options import AllowCode, MachineStudy, StoredResult
from pkm_studies.console import DONE, FAILED
from pkm_studies.user_code import Consent


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
    uncertainty: Annotated[
        str,
        typer.Option(
            metavar="z_um=2,...",
            help="Standard uncertainty of a measured error [by the study's instrument].",
        ),
    ] = "",
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
    from pkm_studies import csv_table

    permission = Consent.of_call(allow_code=allow_code)
    if readings is not None:
        _check_judged(promise, uncertainty, planned)
        if "setup" in csv_table.read(readings).header:
            return _compare(folder, readings, study, permission)
        return _judge(folder, readings)
    return _plan(folder, promise, uncertainty, power, poses, study, permission, planned)


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


def _judge(folder: Path, readings: Path) -> int:
    from pkm_studies import acceptance

    verdict = acceptance.judge_folder(folder, readings)
    for sentence in acceptance.verdict_sentences(verdict):
        print(sentence)
    return DONE if verdict.passed else FAILED


def _compare(
    folder: Path, readings: Path, study: Path | None, permission: Consent
) -> int:
    """Compare readings along runs with what the compensated machine should read."""
    from pkm_studies import acceptance

    check = acceptance.check_folder(folder, readings, study, permission)
    for sentence in acceptance.check_sentences(check):
        print(sentence)
    return DONE if check.passed else FAILED


def _plan(
    folder: Path,
    promise: str,
    uncertainty: str,
    power: float,
    poses: int,
    study: Path | None,
    permission: Consent,
    planned: Path | None,
) -> int:
    from pkm_studies import acceptance

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
    for sentence in acceptance.plan_sentences(section):
        print(sentence)
    least = min(demand.power for demand in section.components.values())
    if least < power:
        print(
            f"{len(section.poses)} poses do not reach the power {power:g}: allow more by"
            " --poses, or measure more accurately (--uncertainty)."
        )
    print(f"To fill in: {path}")
    return DONE
