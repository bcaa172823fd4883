"""The subcommands of `oed`. Each imports what is heavy only when it is called."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pkm_studies.base import console
from pkm_studies.base.errors import InputError
from pkm_studies.commands import campaign as campaign_command
from pkm_studies.commands import compensate as compensate_command
from pkm_studies.commands import history as history_command
from pkm_studies.commands import import_files as import_command
from pkm_studies.commands import new as new_command
from pkm_studies.commands import next as next_command
from pkm_studies.commands import verify as verify_command
from pkm_studies.commands.options import AllowCode
from pkm_studies.stages.outcome import BAD_INPUT, DONE, FAILED, report_outcome

if TYPE_CHECKING:
    from pkm_studies.catalogue.catalogue import CatalogueEntry
    from pkm_studies.study import Study

app = typer.Typer(
    name="oed",
    help=(
        "Optimal experiment design and uncertainty for calibrating parallel kinematic"
        " machines."
    ),
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

StudyPath = Annotated[
    Path,
    typer.Argument(
        metavar="STUDY",
        help="A study file, or the name of a shipped study.",
        show_default=False,
    ),
]
OutFolder = Annotated[
    Path,
    typer.Option(metavar="DIR", help="Folder for the results.", show_default=False),
]
ResultFolder = Annotated[
    Path, typer.Argument(metavar="DIR", help="A result.", show_default=False)
]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed in place of the study's.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", help="Print only errors and failing claims.")
]


class Kind(enum.StrEnum):
    """What `oed list` lists."""

    machines = enum.auto()
    instruments = enum.auto()
    effects = enum.auto()
    criteria = enum.auto()
    formats = enum.auto()
    importers = enum.auto()
    studies = enum.auto()


class Schema(enum.StrEnum):
    """Files that `oed schema` describes."""

    study = enum.auto()
    result = enum.auto()
    readings = enum.auto()


@app.command()
def run(
    study: StudyPath,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the results [out/NAME]."),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    allow_code: AllowCode = False,
) -> int:
    """Run a study: design, identification, accuracy, report."""
    from pkm_studies.base import files
    from pkm_studies.notebook import display

    loaded = _load(study, allow_code)
    folder = out or Path("out") / loaded.name
    files.check_writable(folder)
    from pkm_studies import pipeline  # only now: errors of input come at once

    with display.progress(quiet=quiet) as progress:
        result = pipeline.run(loaded, folder, seed=seed, progress=progress)
    return report_outcome(result, folder, quiet)


@app.command()
def check(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Studies, readings, and machines of your own (my.py).",
            show_default=False,
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
    from pkm_studies.base.user_code import consent
    from pkm_studies.commands import checks, closure_picture

    given = consent(allow_code=allow_code)
    code = DONE
    if picture is not None:
        print(f"Picture: {closure_picture.draw(paths[0], picture, given)}")
    for path, verdict in checks.check(paths, given):
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


@app.command()
def simulate(
    study: StudyPath,
    out: Annotated[
        Path,
        typer.Option(
            metavar="READINGS.csv", help="File for the readings.", show_default=False
        ),
    ],
    allow_code: AllowCode = False,
) -> int:
    """Write readings of a virtual machine, and its truth in a second file."""
    from pkm_studies.base import files

    files.check_new(out)
    loaded = _load(study, allow_code)
    files.check_writable(out.parent)
    from pkm_studies import pipeline

    readings, truth = pipeline.simulate(loaded, out)
    print(f"Readings: {readings}\nTruth: {truth}")
    return DONE


@app.command()
def identify(
    study: StudyPath,
    readings: Annotated[
        Path, typer.Option(metavar="CSV", help="The readings.", show_default=False)
    ],
    out: OutFolder,
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
    allow_code: AllowCode = False,
) -> int:
    """Identify the machine from readings."""
    from pkm_studies.base import files
    from pkm_studies.notebook import display

    loaded = _load(study, allow_code)
    files.check_writable(out)
    from pkm_studies import pipeline

    with display.progress(quiet=quiet) as progress:
        result = pipeline.run(
            loaded,
            out,
            seed=seed,
            progress=progress,
            readings=[readings],
            effects=effects.replace(",", " ").split() if effects else (),
        )
    return report_outcome(result, out, quiet)


@app.command()
def diagnose(
    study: StudyPath,
    out: OutFolder,
    readings: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="The readings [those of the study].", show_default=False
        ),
    ] = None,
    seed: Seed = None,
    quiet: Quiet = False,
    allow_code: AllowCode = False,
) -> int:
    """Find what causes the gap between model and machine: which effect, and where."""
    from pkm_studies.base import files
    from pkm_studies.notebook import display

    loaded = _load(study, allow_code)
    files.check_writable(out)
    from pkm_studies import pipeline

    given = None if readings is None else [readings]
    with display.progress(quiet=quiet) as progress:
        result = pipeline.diagnose(loaded, given, out, seed=seed, progress=progress)
    return report_outcome(result, out, quiet)


@app.command()
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
    allow_code: AllowCode = False,
) -> int:
    """Plan which measurements to do, in which order; read and fit nothing."""
    from pkm_studies.base import files
    from pkm_studies.notebook import display

    loaded = _load(study, allow_code)
    folder = out or Path("out") / f"{loaded.name}-plan"
    files.check_writable(folder)
    from pkm_studies import pipeline

    with display.progress(quiet=quiet) as progress:
        result = pipeline.plan(
            loaded, folder, after=after, seed=seed, progress=progress
        )
    if not quiet and result.plan is not None:
        display.print_plan(result.plan)
    return report_outcome(result, folder, quiet)


@app.command()
def compare(before: ResultFolder, after: ResultFolder) -> int:
    """Compare two sessions of one machine: what changed, and by how much."""
    from pkm_studies.results import comparison

    compared = comparison.compare(before, after)
    for sentence in compared.sentences:
        print(sentence)
    return DONE if compared.is_trusted else FAILED


@app.command()
def report(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...",
            help="Folder with a result.json; several are put side by side.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for a comparison of several results."),
    ] = Path("out/comparison"),
) -> int:
    """Write HTML and PDF again from result.json, or a comparison of several results."""
    from pkm_studies.base import files
    from pkm_studies.results import stored_result

    if len(folders) == 1:
        paths = stored_result.write_report(folders[0])
    else:
        files.check_writable(out)
        paths = stored_result.write_comparison(folders, out)
    for path in paths:
        print(f"Report: {path}")
    return DONE


@app.command(name="list")
def list_entries(
    kind: Annotated[Kind, typer.Argument(show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> int:
    """List the catalogue: machines, instruments, effects, importers and others."""
    if kind is Kind.studies:
        return _list_studies(as_json)
    if kind is Kind.importers:
        return _list_importers(as_json)
    import dataclasses

    from pkm_studies.resolve import conventions

    entries = conventions.listing(kind.value)
    if as_json:
        console.print_json([dataclasses.asdict(entry) for entry in entries])
        return DONE
    _print_rows([(e.name, _entry_lines(e)) for e in entries])
    return DONE


def _entry_lines(entry: CatalogueEntry) -> list[str]:
    """What it is, its source, its frames and its columns."""
    columns = [f"{c['name']}: {c['role']}: {c['about']}" for c in entry.columns]
    return [entry.about, f"source: {entry.source}", *entry.frames, *columns]


def _list_studies(as_json: bool) -> int:
    from pkm_studies.study import shipped

    studies = list(shipped.studies().values())
    if as_json:
        entries = [
            {"name": s.name, "title": s.title, "question": s.question} for s in studies
        ]
        console.print_json(entries)
        return DONE
    _print_rows([(s.name, [s.title, s.question]) for s in studies])
    return DONE


def _list_importers(as_json: bool) -> int:
    from pkm_studies.importers import registry

    known = [(name, one.about) for name, one in registry.importers().items()]
    if as_json:
        console.print_json([{"name": name, "about": about} for name, about in known])
        return DONE
    _print_rows([(name, [about]) for name, about in known])
    return DONE


def _print_rows(rows: list[tuple[str, list[str]]]) -> None:
    """Print names in a column, with the lines about each next to it."""
    width = max((len(name) for name, _ in rows), default=0)
    for name, lines in rows:
        for label, line in zip([name, *[""] * len(lines)], lines, strict=False):
            print(f"{label:<{width}}  {line}")


@app.command()
def schema(
    of: Annotated[
        Schema, typer.Argument(metavar="study|result|readings", show_default=False)
    ],
) -> int:
    """Print a JSON schema, for editors and scripts."""
    from pkm_studies.study import schemas

    console.print_json(schemas.SCHEMAS[of.value]())
    return DONE


app.command()(new_command.new)
app.command(name="import")(import_command.import_files)
app.command()(compensate_command.compensate)
app.command()(verify_command.verify)
app.command()(history_command.history)
app.command()(campaign_command.campaign)
app.command(name="next")(next_command.next_reading)


# -- studies in, results out -----------------------------------------------------------


def _load(path: Path, allow_code: bool) -> Study:
    """The study of a file or of a shipped study's name."""
    from pkm_studies import study
    from pkm_studies.base.user_code import consent
    from pkm_studies.study import shipped

    return study.load(shipped.study_path(path), consent(allow_code=allow_code))
