"""Subcommands on a study: run, simulate, identify, diagnose, plan, forecast, next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oed import safe_files
from pkm_studies import console
from pkm_studies.base import InputError
from pkm_studies.commands.options import (
    AllowCode,
    OptionalStudy,
    OutFolder,
    OwnMachine,
    OwnNumbers,
    Quiet,
    Seed,
    StudyPath,
    Verbose,
    Wanted,
)
from pkm_studies.console import DONE, FAILED
from pkm_studies.user_code import Consent

if TYPE_CHECKING:
    from pkm_studies.study import Study


def run(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the results [out/NAME]."),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Run a study: design, identification, accuracy, report."""
    from pkm_studies.commands import display

    loaded, folder = load_for(study, allow_code, out)
    from pkm_studies import stages  # only now: errors of input come at once

    with display.progress(quiet=quiet) as progress:
        result = stages.run_study(loaded, folder, seed=seed, progress=progress)
    return stages.report_outcome(result, folder, quiet, verbose=verbose)


def simulate(
    study: StudyPath,
    out: Annotated[
        Path, typer.Option(metavar="READINGS.csv", help="File for the readings.")
    ],
    allow_code: AllowCode = False,
) -> int:
    """Write readings of a virtual machine, and its truth in a second file."""
    from pkm_studies import files

    files.check_new(out)
    loaded = load(study, allow_code)
    files.check_writable(out.parent)
    from pkm_studies import stages

    readings, truth = stages.simulate_study(loaded, out)
    print(f"Readings: {readings}\nTruth: {truth}")
    return DONE


def identify(
    readings: Annotated[
        list[Path],
        typer.Option(metavar="CSV", help="The readings; again for a further file."),
    ],
    out: OutFolder,
    study: OptionalStudy = None,
    machine: OwnMachine = None,
    numbers: OwnNumbers = None,
    effects: Annotated[
        str | None,
        typer.Option(
            "--with",
            metavar="EFFECT,...",
            help="Effects to estimate together with the parameters.",
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Identify the machine from readings: of a study, or of a machine by name."""
    from pkm_studies.commands import display

    if (study is None) == (machine is None) or (numbers and machine is None):
        raise InputError(
            "it is not said whose readings these are",
            "give a STUDY, or --machine NAME, with --set NAME_UNIT=NUMBER for its numbers",
        )
    if study is None:
        from pkm_studies.commands.own_numbers import import_numbers

        permission = Consent.from_call(allow_code=allow_code)
        numbers = numbers or []
        study, taken = import_numbers(machine or "", numbers, readings, out, permission)
        if not quiet:
            print(*taken, f"Study: {study}", sep="\n")
    loaded, folder = load_for(study, allow_code, out)
    from pkm_studies import stages

    with display.progress(quiet=quiet) as progress:
        result = stages.run_study(
            loaded,
            folder,
            seed=seed,
            progress=progress,
            readings=None if machine else readings,
            effects=effects.replace(",", " ").split() if effects else (),
        )
    if machine is not None and not quiet:
        from pkm_studies.commands.own_numbers import (
            calibration_answer,
            parameter_sentence,
        )

        print(calibration_answer(loaded, result, folder))
        print(parameter_sentence(loaded, result))
    return stages.report_outcome(result, folder, quiet, verbose=verbose)


def diagnose(
    study: StudyPath,
    out: OutFolder,
    readings: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="CSV",
            help="The readings [those of the study]; again for a further file.",
        ),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Earlier diagnosis: its readings count as well."
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Find what causes the gap between model and machine: which effect, and where."""
    from pkm_studies.commands import display

    loaded, folder = load_for(study, allow_code, out)
    from pkm_studies import stages

    with display.progress(quiet=quiet) as progress:
        result = stages.diagnose_study(
            loaded, readings or None, folder, after=after, seed=seed, progress=progress
        )
    return stages.report_outcome(result, folder, quiet, verbose=verbose)


def plan(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the results [out/NAME-plan]."),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT_DIR",
            help="Result of an earlier session: plan the stages after it.",
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    allow_code: AllowCode = False,
) -> int:
    """Plan which measurements to do, in which order; read and fit nothing."""
    from pkm_studies.commands import display

    loaded, folder = load_for(study, allow_code, out, "-plan")
    from pkm_studies import stages

    with display.progress(quiet=quiet) as progress:
        result = stages.plan_study(
            loaded, folder, after=after, seed=seed, progress=progress
        )
    lines = []
    if not quiet and result.plan is not None:
        lines = display.plan_lines(result.plan, verbose=verbose)
    return stages.report_outcome(result, folder, quiet, verbose=verbose, above=lines)


def forecast(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the results; an estimate there is known [out/NAME-forecast].",
        ),
    ] = None,
    readings: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="Measured nodes: write the table. Without: plan the nodes.",
        ),
    ] = None,
    seed: Seed = None,
    allow_code: AllowCode = False,
) -> int:
    """Plan the nodes of forecast compensation, or make the table of measured ones."""
    loaded, folder = load_for(study, allow_code, out, "-forecast")
    from pkm_studies import stages
    from pkm_studies.stages import forecast_sentences

    result = stages.forecast_study(loaded, folder, readings=readings, seed=seed)
    for sentence in forecast_sentences(result.forecast):
        print(sentence)
    name, phrase = ("forecast_nodes.csv", "To fill in")
    if result.forecast is not None and result.forecast.readings:
        name, phrase = ("forecast_table.csv", "Table")
    print(f"{phrase}: {safe_files.latest(folder / name)}")
    failing = [
        claim.failure(loaded.path.name) for claim in result.claims if not claim.met
    ]
    for sentence in failing:
        console.print_error(sentence)
    return FAILED if failing else DONE


def load(path: Path, allow_code: bool) -> Study:
    """The study of a file or of a shipped study's name."""
    from pkm_studies import shipped, study

    return study.Study.load(
        shipped.study_path(path), Consent.from_call(allow_code=allow_code)
    )


def load_for(
    path: Path, allow_code: bool, out: Path | None, suffix: str = ""
) -> tuple[Study, Path]:
    """The study, and the folder of its results: `out`, else one of the study's name.

    Raises InputError where the folder cannot be written, or has a result that the study
    rests on.
    """
    from pkm_studies import files

    loaded = load(path, allow_code)
    folder = out or Path("out") / f"{loaded.name}{suffix}"
    files.check_writable(folder)
    named = {"earlier": [loaded.prior.earlier or ""], "from": loaded.prior.from_}
    for key, names in named.items():
        for name in filter(None, names):
            if (loaded.folder / name).resolve() == folder.resolve():
                raise InputError(
                    "the result would replace the one that its prior is taken from",
                    "give another --out",
                    file=str(loaded.path),
                    field=f"prior.{key}",
                    value=name,
                )
    return loaded, folder


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
    loaded = load(study, allow_code)
    if after is not None:
        _check_alone(after, readings, wanted, follow=follow)
        from pkm_studies.sessions import visit_lines

        print("\n".join(visit_lines(loaded, study, after)))
        return DONE
    if readings is None:
        raise InputError(
            "there is nothing to advise from",
            "give --readings FILE.csv, or --after DIR with the folder of a diagnosis",
            field="--readings",
        )
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
