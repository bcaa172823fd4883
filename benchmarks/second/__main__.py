"""The diagnosis on the second generator: cases, diagnoses and table by one command.

    python -m benchmarks.second --out FOLDER --seed 7 --cases 20

draws 20 cases of each machine, diagnoses each under the estimated and the true noise
law, and prints the table. What FOLDER has already is kept, so that a broken run goes on
where it was.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.second import adapter, cases, run, table


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 1 where a diagnosis failed, 2 bad input."""
    options = _parser().parse_args(arguments)
    if options.cases < 1:
        print(f"--cases {options.cases}: give at least 1", file=sys.stderr)
        return 2
    try:
        cases.generate(
            options.out,
            options.seed,
            options.cases,
            options.machines,
            options.generator,
        )
    except FileNotFoundError as missing:
        print(f"skipped: the second generator is not there ({missing})")
        return 0
    except (OSError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return 2
    every = cases.listing(options.out, options.machines)
    chosen = every[options.first :: options.step]
    failed = 0
    if not options.score_only:
        failed = run.run(chosen, options.laws, report=_report)
    print(table.markdown(chosen, options.laws))
    return 1 if failed else 0


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.second", description=__doc__
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the set")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=20, help="of each machine")
    parser.add_argument(
        "--machines", nargs="+", choices=adapter.MACHINES, default=adapter.MACHINES
    )
    parser.add_argument("--laws", nargs="+", choices=run.LAWS, default=run.LAWS)
    parser.add_argument("--step", type=int, default=1, help="every so many cases only")
    parser.add_argument("--first", type=int, default=0, help="the first of these")
    parser.add_argument("--score-only", action="store_true")
    parser.add_argument("--generator", type=Path, default=cases.GENERATOR)
    return parser


if __name__ == "__main__":
    sys.exit(main())
