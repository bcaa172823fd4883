"""The diagnosis on the second generator: its cases, and the table of their diagnoses.

    python -m benchmarks.second generate --seed 7 --cases 20
    PYTHONPATH=. oed campaign --allow-code benchmarks/second.campaign.toml --seeds 20
    python -m benchmarks.second table

draws 20 cases of each machine, diagnoses each under the estimated and the true noise
law, and prints the table.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.exit_code import exit_code
from benchmarks.second import adapter, cases, table

#: folder of the campaign, and of the set that it reads
CAMPAIGN, SET = Path("out/second"), Path("out/second/set")


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 2 bad input."""
    return exit_code(_parser(), arguments)


def _generate(options: argparse.Namespace) -> int:
    if options.cases < 1:
        raise ValueError(f"--cases {options.cases}: give at least 1")
    try:
        cases.generate(
            options.out,
            options.seed,
            options.cases,
            adapter.MACHINES,
            options.generator,
        )
    except FileNotFoundError as missing:
        print(f"skipped: the second generator is not there ({missing})")
    return 0


def _table(options: argparse.Namespace) -> int:
    print(table.markdown(options.campaign))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.second", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    generate = commands.add_parser("generate", help="draw the cases of a set")
    generate.add_argument("--out", type=Path, default=SET, help="folder of the set")
    generate.add_argument("--seed", type=int, default=1)
    generate.add_argument("--cases", type=int, default=20, help="of each machine")
    generate.add_argument("--generator", type=Path, default=cases.GENERATOR)
    generate.set_defaults(run=_generate)
    results = commands.add_parser("table", help="print the table of the diagnoses")
    results.add_argument("--campaign", type=Path, default=CAMPAIGN, help="its folder")
    results.set_defaults(run=_table)
    return parser


if __name__ == "__main__":
    sys.exit(main())
