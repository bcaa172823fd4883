"""The table of a campaign.

    python -m benchmarks.harness NAME

The campaign `benchmarks/NAME.campaign.toml` comes first, see `benchmarks.harness`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pkm_campaign import read_row

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
    "attainable": "real_machines.plans:attainable_table",
}


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.harness", description=__doc__
    )
    parser.add_argument("name", choices=TABLES, help="of the campaign")
    parser.add_argument("--campaign", type=Path, help="its folder; out/NAME")
    options = parser.parse_args(arguments)
    folder = options.campaign or Path("out") / options.name
    module, _, function = TABLES[options.name].partition(":")
    table: Table = getattr(importlib.import_module(f"benchmarks.{module}"), function)
    try:
        print(table(rows(folder)))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def rows(folder: Path) -> list[dict[str, Any]]:
    """The rows without an error that a campaign has in its folder, done or not.

    Raises ValueError where there are none.
    """
    every = [read_row(path) for path in sorted((folder / "cases").glob("*.json"))]
    valid = [row for row in every if not row.get("error")]
    if not valid:
        file = f"benchmarks/{folder.name}.campaign.toml"
        raise ValueError(f"{folder}: no case; run `oed campaign {file}` first")
    return valid


if __name__ == "__main__":
    sys.exit(main())
