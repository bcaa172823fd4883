"""Records of cases that are drawn again, a line of JSON each, and their command line.

A run goes on where its file ends.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.second import cases as case_files
from benchmarks.second.adapter import MACHINES
from benchmarks.second.replay import Generator, Replay
from benchmarks.second.score import SIX

#: what a case's record holds beside machine and name; None where the case does not count
RecordOf = Callable[
    [Generator, Replay, str, np.random.Generator], dict[str, Any] | None
]
#: the lines of a table of records
TableOf = Callable[[Sequence[Mapping[str, Any]]], Sequence[str]]


def record_cases(
    options: argparse.Namespace, kinds: Collection[str], record_of: RecordOf
) -> int:
    """Append the records of the cases of some kinds, of sqrt(lambda) 6 and more.

    Raises ValueError for fewer than one case.
    """
    if options.cases < 1:
        raise ValueError(f"--cases {options.cases}: give at least 1")
    try:
        generator = Generator(options.generator)
    except ModuleNotFoundError as missing:
        print(f"skipped: the second generator is not there ({missing})")
        return 0
    done = {(r["machine"], r["case"]) for r in records(options.out)}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    plans = {m: generator.kinds(options.seed, m, options.cases) for m in MACHINES}
    for number in range(options.cases):
        for machine in MACHINES:
            name, kind = f"case_{number:03d}", plans[machine][number]
            if (machine, name) in done or kind[0] not in kinds or kind[2] < SIX:
                continue
            replay = generator.replay(options.seed, machine, number, kind)
            key = zlib.crc32(f"{options.seed}/{machine}/{name}".encode())
            rng = np.random.default_rng(key)
            record = record_of(generator, replay, machine, rng)
            if record is not None:
                line = json.dumps({"machine": machine, "case": name} | record)
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")
    return 0


def records(path: Path) -> list[dict[str, Any]]:
    """Records of a file, a line each; none without it."""
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def print_table(options: argparse.Namespace, table_of: TableOf) -> int:
    """Print the table of a file of records. Raises ValueError where there are none."""
    found = records(options.file)
    if not found:
        raise ValueError(f"{options.file}: no cases; run the command `run` first")
    print("\n".join(table_of(found)))
    return 0


def parser(
    name: str,
    about: str | None,
    run: Callable[[argparse.Namespace], int],
    table: Callable[[argparse.Namespace], int],
) -> argparse.ArgumentParser:
    """Command line of a module with the commands `run` and `table`."""
    whole = argparse.ArgumentParser(
        prog=f"python -m benchmarks.second.{name}", description=about
    )
    commands = whole.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("run", help="append the records of cases")
    recording.add_argument("--seed", type=int, required=True)
    recording.add_argument("--cases", type=int, default=20, help="of each machine")
    recording.add_argument("--out", type=Path, default=Path(f"out/{name}.jsonl"))
    recording.add_argument("--generator", type=Path, default=case_files.GENERATOR)
    recording.set_defaults(run=run)
    printing = commands.add_parser("table", help="print the table of a file of records")
    printing.add_argument("file", type=Path)
    printing.set_defaults(run=table)
    return whole
