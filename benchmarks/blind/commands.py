"""Options of the commands `list` and `score`.

Their modules are imported only when they run.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

_report = partial(print, flush=True)


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands."""
    _list_options(commands.add_parser("list", help="list cases by what is in them"))
    _score_options(commands.add_parser("score", help="score the results of a set"))


def _list_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--cases",
        type=Path,
        required=True,
        metavar="SET",
        help="folder that `generate` wrote",
    )
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
    parser.add_argument(
        "--or-none", action="store_true", help="write an empty list where no case fits"
    )
    parser.set_defaults(run=_list)


def _score_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("out/blind"),
        help="of the sets and the campaign's cases; the score goes there too",
    )
    parser.add_argument(
        "--known-noise",
        type=Path,
        default=Path("out/blind_known_noise"),
        metavar="DIR",
        help="folder of that campaign's cases",
    )
    parser.add_argument(
        "--table", type=Path, help="Markdown file of the table; FOLDER/RESULTS.md"
    )
    parser.add_argument(
        "--workers", type=_count, default=0, help="processes; one a core if not given"
    )
    parser.set_defaults(run=_score)


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value}: give 0 or more")
    return value


def _list(arguments: argparse.Namespace) -> int:
    from benchmarks.blind import listing

    options = {
        n: getattr(arguments, n)
        for n in (
            "kinds",
            "machines",
            "least",
            "apart",
            "withhold",
            "or_none",
            "workers",
        )
    }
    print(
        f"{listing.write(arguments.cases, arguments.out, **options)} cases in {arguments.out}"
    )
    return 0


def _score(arguments: argparse.Namespace) -> int:
    from benchmarks.blind import score

    score.run(
        arguments.folder,
        arguments.known_noise,
        page=arguments.table or arguments.folder / "RESULTS.md",
        workers=arguments.workers,
        report=_report,
    )
    return 0
