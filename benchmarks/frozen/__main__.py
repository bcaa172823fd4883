"""Freeze the numbers of results, and compare a changed tree with them.

    python -m benchmarks.frozen make
    python -m benchmarks.frozen compare
    python -m benchmarks.frozen compare --kinds studies --names a3_ball_bar micro_cmm

`make` writes the numbers of all shipped studies and of 40 cases of each generator of
blind cases as they are now; `compare` computes them again and lists what differs: by
more than 1e-9 where nothing is drawn, by more than 1e-3 standard deviations elsewhere.
Numbers are made from a named commit, whose name they hold.
"""

from __future__ import annotations

import argparse
import gzip
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks.frozen import sources
from benchmarks.frozen.numbers import Difference, differences
from benchmarks.frozen.sources import FOLDER, KINDS, Source

FILE = FOLDER / "frozen.json.gz"
#: differences that are printed of a source
PRINTED = 8


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 equal or made, 1 different, 2 bad input."""
    options = _parser().parse_args(arguments)
    return int(options.run(options))


def _make(options: argparse.Namespace) -> int:
    documents = {f"{s.kind}:{s.name}": n for s, n in _computed(options)}
    record = {"commit": _commit(), "documents": documents}
    text = json.dumps(record, sort_keys=True).encode()
    options.file.write_bytes(gzip.compress(text, 9, mtime=0))
    print(f"{len(documents)} documents in {options.file}")
    return 0


def _compare(options: argparse.Namespace) -> int:
    record = json.loads(gzip.decompress(options.file.read_bytes()))
    print(f"frozen at {record['commit']}")
    changed = 0
    for source, after in _computed(options):
        label = f"{source.kind}:{source.name}"
        before = record["documents"].get(label)
        if before is None:
            print(f"{label}: not frozen", flush=True)
            continue
        apart = differences(before, after)
        changed += bool(apart)
        _print_differences(label, apart, len(before))
    print(f"{changed} documents differ" if changed else "equal")
    return int(changed > 0)


def _print_differences(label: str, apart: list[Difference], count: int) -> None:
    verdict = f"{len(apart)} of {count} numbers differ" if apart else "equal"
    print(f"{label}: {verdict}", flush=True)
    for difference in apart[:PRINTED]:
        before, after = difference.before, difference.after
        print(f"    {difference.path}: {before} -> {after}", flush=True)


def _computed(
    options: argparse.Namespace,
) -> Iterator[tuple[Source, dict[str, float]]]:
    kinds = tuple(options.kinds)
    sources.prepare(kinds)
    wanted = sources.listing(kinds)
    if options.names:
        wanted = [source for source in wanted if source.name in options.names]
    with ProcessPoolExecutor(options.workers) as pool:
        yield from pool.map(sources.compute, wanted)


def _commit() -> str:
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.frozen", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name, run, text in (
        ("make", _make, "compute and write the numbers"),
        ("compare", _compare, "compute the numbers again and compare"),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument("--file", type=Path, default=FILE)
        command.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
        command.add_argument("--names", nargs="+", default=[])
        command.add_argument("--workers", type=int, default=2)
        command.set_defaults(run=run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
