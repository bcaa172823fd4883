"""The command `oed`. Exit 0: done; 1: a claim fails; 2: bad input, told in one
paragraph; 130: interrupted.

Everything heavy is imported inside the command that needs it, so that `oed --help`
answers at once.
"""

from __future__ import annotations

import enum
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pkm_studies.errors import InputError, shorten

if TYPE_CHECKING:
    from oed.result import Claim, StudyResult

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
#: errors of the kernel that speak of the input, by module: looked for only where the
#: module is loaded
INPUT_ERRORS = {
    "oed.units": "UnitError",
    "oed.kinematics": "AssemblyError",
    "oed.readings_table": "ReadingsError",
    "oed.identify": "IdentificationError",
}

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
        metavar="STUDY.study.toml", help="The study file.", show_default=False
    ),
]
Quiet = Annotated[
    bool, typer.Option("--quiet", help="Say nothing but errors and failing claims.")
]


class Kind(enum.StrEnum):
    """What `oed list` lists."""

    machines = enum.auto()
    instruments = enum.auto()
    effects = enum.auto()
    criteria = enum.auto()


class Schema(enum.StrEnum):
    """What `oed schema` tells."""

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
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed instead of the study's.")
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Run a study: design, identification, accuracy, report."""
    from pkm_studies import display, files
    from pkm_studies.study import load

    said = load(study)
    folder = out or Path("out") / said.name
    files.free(folder)
    from pkm_studies import pipeline  # only now: bad input is told at once

    with display.shown(quiet=quiet) as shown:
        result = pipeline.run(said, folder, seed=seed, progress=shown)
    return _tell(result, folder, quiet)


@app.command()
def check(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Studies and readings.", show_default=False
        ),
    ],
) -> int:
    """Check studies and readings; run nothing."""
    from pkm_studies import checks

    bad = 0
    for path, told in checks.check(paths):
        if isinstance(told, InputError):
            _say(str(told))
            bad += 1
        else:
            print(f"{path}: {told}")
    return BAD_INPUT if bad else DONE


@app.command()
def simulate(
    study: StudyPath,
    out: Annotated[
        Path,
        typer.Option(
            metavar="READINGS.csv", help="File for the readings.", show_default=False
        ),
    ],
) -> int:
    """Write readings of a virtual machine, and its truth beside them."""
    from pkm_studies import files
    from pkm_studies.study import load

    said = load(study)
    files.free(out.parent)
    from pkm_studies import pipeline

    readings, truth = pipeline.simulate(said, out)
    print(f"Readings: {readings}\nTruth: {truth}")
    return DONE


@app.command()
def identify(
    study: StudyPath,
    readings: Annotated[
        Path, typer.Option(metavar="CSV", help="The readings.", show_default=False)
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for the results.", show_default=False),
    ],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed instead of the study's.")
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Identify the machine from readings."""
    from pkm_studies import display, files
    from pkm_studies.study import load

    said = load(study)
    files.free(out)
    from pkm_studies import pipeline

    with display.shown(quiet=quiet) as shown:
        result = pipeline.run(said, out, seed=seed, progress=shown, readings=[readings])
    return _tell(result, out, quiet)


@app.command()
def diagnose(
    study: StudyPath,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for the results.", show_default=False),
    ],
    readings: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="The readings [those of the study].", show_default=False
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed instead of the study's.")
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Find what causes the gap between model and machine: which effect, where, how far
    it shrinks.
    """
    from pkm_studies import display, files
    from pkm_studies.study import load

    said = load(study)
    files.free(out)
    from pkm_studies import pipeline

    given = None if readings is None else [readings]
    with display.shown(quiet=quiet) as shown:
        result = pipeline.diagnose(said, given, out, seed=seed, progress=shown)
    return _tell(result, out, quiet)


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
            metavar="RESULT_DIR", help="Plan the rest, with what was identified there."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed instead of the study's.")
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Plan which measurements to do, in which order; read and fit nothing."""
    from pkm_studies import display, files
    from pkm_studies.study import load

    said = load(study)
    folder = out or Path("out") / f"{said.name}-plan"
    files.free(folder)
    from pkm_studies import pipeline

    with display.shown(quiet=quiet) as shown:
        result = pipeline.plan(said, folder, after=after, seed=seed, progress=shown)
    if not quiet and result.plan is not None:
        display.stages(result.plan)
    return _tell(result, folder, quiet)


@app.command()
def report(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Folder with a result.json.", show_default=False
        ),
    ],
) -> int:
    """Write the HTML and PDF report again from result.json."""
    from pkm_studies import result_folder

    for written in result_folder.write_report(folder):
        print(f"Report: {written}")
    return DONE


@app.command(name="list")
def list_(
    kind: Annotated[Kind, typer.Argument(show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> int:
    """List what there is to choose from, with sources."""
    import dataclasses
    import json

    from pkm_studies import catalogue

    entries = catalogue.listing(kind.value)
    if as_json:
        print(
            json.dumps(
                [dataclasses.asdict(e) for e in entries], indent=2, ensure_ascii=False
            )
        )
    elif not entries:
        print(f"There are no {kind.value} yet.")
    else:
        width = max(len(e.name) for e in entries)
        for e in entries:
            print(f"{e.name:<{width}}  {e.about}\n{'':<{width}}  source: {e.source}")
    return DONE


@app.command()
def schema(
    of: Annotated[
        Schema, typer.Argument(metavar="study|result|readings", show_default=False)
    ],
) -> int:
    """Print a JSON schema, for editors and scripts."""
    import json

    from pkm_studies import schemas

    print(json.dumps(schemas.SCHEMAS[of.value](), indent=2, ensure_ascii=False))
    return DONE


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the study.", show_default=False)],
    machine: Annotated[
        str, typer.Option(help="A machine of `oed list machines`.", show_default=False)
    ],
    instrument: Annotated[
        str, typer.Option(help="One of `oed list instruments`.", show_default=False)
    ],
) -> int:
    """Write a commented study to start from."""
    from pkm_studies import template

    path = template.write(name, machine, instrument, Path())
    print(f"Study: {path}; edit it, then: oed run {path}")
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    # before NumPy is loaded: the matrices are small, and two BLAS threads on busy cores
    # slow them down tenfold
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        code = app(
            args=None if arguments is None else list(arguments),
            prog_name="oed",
            standalone_mode=False,
        )
        if code == INTERRUPTED:  # typer's word for Ctrl-C
            _say("interrupted: files written so far are whole")
        sys.stdout.flush()
        return code if isinstance(code, int) else DONE
    except InputError as error:
        return _bad(str(error))
    except (BrokenPipeError, SystemExit):
        # the reader of our output has gone (`oed list machines | head`), which typer
        # tells as SystemExit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        told = error.strerror or type(error).__name__
        return _bad(
            f"{error.filename or 'a file'}: {told.lower()}; check the name, its folder"
            " and its permissions."
        )
    except _kernel_errors() as error:
        return _bad(shorten(str(error), 500))
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        return _bad(
            f"{error.format_message().rstrip('.')}; see `oed --help`."
        )  # how the command was called


def _kernel_errors() -> tuple[type[BaseException], ...]:
    loaded = [(sys.modules.get(module), name) for module, name in INPUT_ERRORS.items()]
    return tuple(getattr(module, name) for module, name in loaded if module is not None)


def _bad(paragraph: str) -> int:
    _say(paragraph)
    return BAD_INPUT


def _say(line: str) -> None:
    print(f"oed: {line}", file=sys.stderr, flush=True)


def _tell(result: StudyResult, folder: Path, quiet: bool) -> int:
    """Headline, where the report is, claims; the exit code."""
    if not quiet:
        for sentence in result.headline:
            print(sentence)
        written = [
            folder / n
            for n in ("report.html", "report.pdf", "result.json")
            if (folder / n).is_file()
        ]
        print(f"Report: {', '.join(str(p) for p in written)}")
        for claim in result.claims:
            print(f"Claim {_told(claim)}")
    failing = [c for c in result.claims if not c.met]
    for claim in failing:
        _say(f"claim {_told(claim)}")
    return FAILED if failing else DONE


def _told(claim: Claim) -> str:
    if claim.met and isinstance(claim.measured, str):
        return f"{claim.claim}: met: {claim.wanted}"
    measured = (
        f"{claim.measured:.6g}" if isinstance(claim.measured, float) else claim.measured
    )
    return (
        f"{claim.claim}: {'met' if claim.met else 'not met'}: {claim.wanted}, measured"
        f" {measured}"
    )


if __name__ == "__main__":
    sys.exit(main())
