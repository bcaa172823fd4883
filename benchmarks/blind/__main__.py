"""python -m benchmarks.blind COMMAND, from the project's root.

`generate` writes a set of cases, `oed campaign benchmarks/blind.campaign.toml` diagnoses
them, `score` scores the results; `list` names some of the cases. The whole way from
nothing to a table is in `score.py`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import time
from pathlib import Path

from benchmarks.blind import commands as other
from pkm_studies.base import InputError


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    _generate_options(commands.add_parser("generate", help="write a set of cases"))
    other.add(commands)
    _forms_options(
        commands.add_parser(
            "forms",
            help="how large effects must be, how far they depart from the textbook",
        )
    )
    options = parser.parse_args(arguments)
    try:
        return int(options.run(options))
    except (OSError, ValueError, InputError) as error:
        print(error, file=sys.stderr)
        return 2


def _generate_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        help="folder to write to; what is there is kept",
    )
    parser.add_argument(
        "--set", dest="name", choices=("dev", "blind", "six"), required=True
    )
    parser.add_argument(
        "--cases",
        type=int,
        default=200,
        help="how many (200 hold every kind; 1000 every law 75 times)",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--machines",
        nargs="+",
        default=[],
        help="only these (cases keep their numbers)",
    )
    parser.add_argument("--kinds", nargs="+", default=[], help="only these kinds")
    parser.set_defaults(run=_generate)


def _generate(options: argparse.Namespace) -> int:
    from benchmarks.blind.generator import write

    start = time.perf_counter()

    def report(done: int, count: int) -> None:
        if done % 50 == 0 or done == count:
            seconds = time.perf_counter() - start
            print(f"{done} of {count} cases, {seconds:.0f} s", flush=True)

    if options.cases < 1:
        raise ValueError(f"--cases {options.cases}: give at least 1")
    new = write.generate(
        options.out,
        name=options.name,
        count=options.cases,
        seed=options.seed,
        machines=options.machines,
        kinds=options.kinds,
        report=report,
    )
    print(f"{new} new in {options.out}")
    return 0


def _forms_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--machines",
        nargs="+",
        default=["a3", "planar", "delta", "hexapod", "hexaglide"],
    )
    parser.add_argument(
        "--draws", type=int, default=12, help="forms drawn of each effect"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.set_defaults(run=_forms)


def _forms(options: argparse.Namespace) -> int:
    from benchmarks.blind.generator import forms
    from benchmarks.blind.generator.machine_plans import PLANS

    unknown = [m for m in options.machines if m not in PLANS]
    if unknown:
        raise ValueError(f"--machines {unknown[0]}: there are {', '.join(PLANS)}")
    print(forms.markdown(tuple(options.machines), options.draws, options.seed))
    return 0


if __name__ == "__main__":
    sys.exit(main())
