"""Second visits on the second generator: records of cases, and their table.

    python -m benchmarks.visits run --seed 52000 --cases 40 --out out/visits.jsonl
    python -m benchmarks.visits table out/visits.jsonl

Each case is diagnosed, visited again for what the diagnosis advises, and diagnosed with
both visits. A run goes on where its file ends.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import json
import sys
from pathlib import Path

from benchmarks.exit_code import exit_code
from benchmarks.second import cases
from benchmarks.visits import later, run, table
from oed.mechanism.inverse import AssemblyError

#: kind and severity of the cases, in turn
KINDS = (
    ("single", 6),
    ("pair", 10),
    ("single", 10),
    ("single", 20),
    ("pair", 20),
    ("unknown", 10),
    ("single", 6),
    ("pair", 6),
    ("single", 10),
)


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 2 bad input."""
    return exit_code(_parser(), arguments)


def _run(options: argparse.Namespace) -> int:
    if not (cases.GENERATOR / "make.py").is_file():
        print(f"skipped: the second generator is not there ({cases.GENERATOR})")
        return 0
    make = later.modules(cases.GENERATOR)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.touch()
    known = len(options.out.read_text(encoding="utf-8").splitlines())
    for number in range(known, options.cases):
        kind, severity = KINDS[number % len(KINDS)]
        machine = run.MACHINES[number % len(run.MACHINES)]
        key = (machine, kind, severity, options.seed + number)
        try:
            record = run.record(make, *key)
        except (ValueError, AssemblyError) as error:
            record = {"machine": machine, "kind": kind, "failure": str(error)}
        with options.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
    return 0


def _table(options: argparse.Namespace) -> int:
    lines = options.records.read_text(encoding="utf-8").splitlines()
    print(table.markdown([json.loads(line) for line in lines]))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.visits", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("run", help="diagnose cases, and visit them again")
    draw.add_argument("--seed", type=int, default=52000)
    draw.add_argument("--cases", type=int, default=40)
    draw.add_argument("--out", type=Path, default=Path("out/visits.jsonl"))
    draw.set_defaults(run=_run)
    results = commands.add_parser("table", help="print the table of the records")
    results.add_argument("records", type=Path)
    results.set_defaults(run=_table)
    return parser


if __name__ == "__main__":
    sys.exit(main())
