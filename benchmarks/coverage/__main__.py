"""Coverage of intervals and bands on virtual machines that the toolkit did not make.

    python -m benchmarks.coverage --machines 300 --out out/coverage
    python -m benchmarks.coverage --page docs/benchmarks/coverage.md

The second form writes the table of what is there, and measures what is missing.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.coverage import campaign, cell, table
from benchmarks.coverage.configurations import CONFIGURATIONS
from benchmarks.coverage.noise import LAWS

#: machines of each cell, so that the whole table takes 40 minutes on one core
MACHINES = 200


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the campaign and print or write its table."""
    options = _parser().parse_args(arguments)
    cells = table.order(options.configurations, options.laws)
    campaign.run(
        options.out,
        options.configurations,
        options.laws,
        options.machines,
        options.seed,
    )
    figures = {}
    for name, law in cells:
        results = campaign.load(options.out, name, law, options.seed, options.machines)
        figures[name, law] = cell.summarise(results)
    text = table.markdown(figures)
    minutes = sum(c.cpu_s for c in figures.values()) / 60.0
    text += f"\n\nProcessor time: {minutes:.0f} minutes."
    if options.page is None:
        print(text)
    else:
        table.write_block(options.page, "coverage table", text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage")
    parser.add_argument("--machines", type=int, default=MACHINES, help="of each cell")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/coverage"))
    parser.add_argument("--page", type=Path, help="page to write the table into")
    parser.add_argument(
        "--configurations", nargs="+", default=[*CONFIGURATIONS], choices=CONFIGURATIONS
    )
    parser.add_argument("--laws", nargs="+", default=[*LAWS], choices=LAWS)
    return parser


if __name__ == "__main__":
    main()
