"""Options of the commands `run`, `known-noise`, `list` and `score`.

Their modules are imported only when they run.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

_report = partial(print, flush=True)


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands."""
    _run_options(commands.add_parser("run", help="diagnose every case of a set"))
    _known_options(
        commands.add_parser(
            "known-noise",
            help="diagnose again as an observer who knows the noise's covariance",
        )
    )
    _list_options(
        commands.add_parser(
            "list", help="list cases by what is in them, for `run --list`"
        )
    )
    _score_options(commands.add_parser("score", help="score the results of a set"))


def _set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cases",
        type=Path,
        required=True,
        metavar="SET",
        help="folder that `generate` wrote",
    )


def _workers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers", type=_count, default=0, help="processes; one a core if not given"
    )
    parser.add_argument(
        "--again", action="store_true", help="compute again what is there already"
    )


def _run_options(parser: argparse.ArgumentParser) -> None:
    _set(parser)
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="RESULTS",
        help="folder of the results",
    )
    parser.add_argument(
        "--only",
        default="",
        help="machines or plans, separated by commas: a3,planar_full",
    )
    parser.add_argument(
        "--list",
        dest="listed",
        type=Path,
        help="file of cases, and of effects withheld from each",
    )
    parser.add_argument("--limit", type=_count, default=0, help="at most so many cases")
    parser.add_argument(
        "--without",
        default="",
        metavar="EFFECT",
        help="withhold an effect; `each`: every one in turn",
    )
    parser.add_argument(
        "--dask",
        default="",
        metavar="ADDRESS",
        help="scheduler of a Dask cluster that sees the same files",
    )
    parser.add_argument("--seed", type=_count, default=0)
    _workers(parser)
    parser.set_defaults(run=_run)


def _known_options(parser: argparse.ArgumentParser) -> None:
    _set(parser)
    parser.add_argument(
        "--results", type=Path, required=True, help="folder that `run` writes"
    )
    parser.add_argument(
        "--list",
        dest="listed",
        type=Path,
        help="file of cases; lines with an effect withheld are not",
    )
    parser.add_argument("--limit", type=_count, default=0, help="at most so many cases")
    parser.add_argument("--seed", type=_count, default=0)
    _workers(parser)
    parser.set_defaults(run=_known)


def _list_options(parser: argparse.ArgumentParser) -> None:
    _set(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    parser.add_argument("--kinds", nargs="+", default=[])
    parser.add_argument("--machines", nargs="+", default=[])
    parser.add_argument("--least", type=float, default=0.0, help="least sqrt(lambda)")
    parser.add_argument(
        "--apart",
        type=float,
        default=0.0,
        help="least sqrt(lambda_k|j) of known effects from any rival",
    )
    parser.add_argument(
        "--workers", type=_count, default=0, help="processes; one a core if not given"
    )
    parser.add_argument(
        "--withhold",
        action="store_true",
        help="withhold each case's effect from the library",
    )
    parser.set_defaults(run=_list)


def _score_options(parser: argparse.ArgumentParser) -> None:
    _set(parser)
    parser.add_argument(
        "--results", type=Path, required=True, help="folder that `run` wrote"
    )
    parser.add_argument(
        "--out", type=Path, help="folder of the scores; RESULTS/score if not given"
    )
    parser.add_argument(
        "--pairs",
        type=Path,
        metavar="SET",
        help="further set of pairs; results in the same folder",
    )
    parser.add_argument(
        "--table", type=Path, help="Markdown file to write the table to"
    )
    _workers(parser)
    parser.set_defaults(run=_score)


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value}: give 0 or more")
    return value


def _run(arguments: argparse.Namespace) -> int:
    from benchmarks.blind import run

    failed = run.run(
        arguments.cases,
        arguments.out,
        only=[n for n in arguments.only.split(",") if n],
        listed=arguments.listed,
        limit=arguments.limit,
        without=arguments.without,
        workers=arguments.workers,
        dask=arguments.dask,
        again=arguments.again,
        seed=arguments.seed,
        report=_report,
    )
    return _exit_code(failed)


def _known(arguments: argparse.Namespace) -> int:
    from benchmarks.blind import known_noise

    options = {
        n: getattr(arguments, n)
        for n in ("listed", "limit", "workers", "again", "seed")
    }
    return _exit_code(
        known_noise.run_all(
            arguments.cases, arguments.results, report=_report, **options
        )
    )


def _exit_code(failed: int) -> int:
    if failed:
        print(
            f"{failed} diagnoses failed: see `error` in their files; they are tried"
            " again next time",
            file=sys.stderr,
        )
    return 1 if failed else 0


def _list(arguments: argparse.Namespace) -> int:
    from benchmarks.blind import listing

    options = {
        n: getattr(arguments, n)
        for n in ("kinds", "machines", "least", "apart", "withhold", "workers")
    }
    print(
        f"{listing.write(arguments.cases, arguments.out, **options)} cases in {arguments.out}"
    )
    return 0


def _score(arguments: argparse.Namespace) -> int:
    from benchmarks.blind import score

    out = arguments.out or arguments.results / "score"
    options = {n: getattr(arguments, n) for n in ("pairs", "workers", "again")}
    score.run(
        arguments.cases,
        arguments.results,
        out=out,
        page=arguments.table,
        report=_report,
        **options,
    )
    return 0
