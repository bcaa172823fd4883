"""The table of a campaign, printed or written into a page.

    python -m benchmarks.harness NAME
    python -m benchmarks.harness NAME --page PAGE.md  # between its marks

The campaign `benchmarks/NAME.campaign.toml` comes first, see `benchmarks.harness`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import pages

Table = Callable[[Sequence[Mapping[str, Any]]], str]
#: where the table of a campaign's rows is made: the judge's, unless it asks otherwise
TABLES = {
    "blind": "harness.judge:table",
    "second": "harness.judge:table",
    "third": "harness.judge:table",
    "visits": "visits.cases:table",
    "coverage": "coverage.intervals:table",
    "next_reading": "next_reading:table",
    "ranks": "coverage.ranks:table",
    "random_machines": "random_machines.cases:table",
    "real_machines": "real_machines.cases:accuracy_table",
    "real_answers": "real_machines.cases:answers_table",
    "real_plans": "real_machines.plans:realised_table",
    "attainable": "real_machines.plans:attainable_table",
}


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 bad input."""
    options = _parser().parse_args(arguments)
    folder = options.campaign or Path("out") / options.name
    try:
        text = _table(options.name)(pages.rows(folder))
        if options.page is None:
            print(text)
        else:
            pages.write_block(options.page, f"{options.name} table", text)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _table(name: str) -> Table:
    module, _, function = TABLES[name].partition(":")
    table: Table = getattr(importlib.import_module(f"benchmarks.{module}"), function)
    return table


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.harness", description=__doc__
    )
    parser.add_argument("name", choices=TABLES, help="of the campaign")
    parser.add_argument("--campaign", type=Path, help="its folder; out/NAME")
    parser.add_argument("--page", type=Path, help="page to write the table into")
    return parser


if __name__ == "__main__":
    sys.exit(main())
