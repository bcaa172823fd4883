"""The diagnosis in a third world: its cases, and the table of their diagnoses.

    python -m benchmarks.third --seeds 300 500 --out out/third.jsonl
    python -m benchmarks.third --table out/third.jsonl

diagnoses the cases of seeds 300 to 499 under the estimated noise law, a line of JSON
each, and writes the figures into the page docs/benchmarks/third.md. A run that was
interrupted goes on where it stopped.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.second import run
from benchmarks.third import cases, table


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done, 2 bad input."""
    options = _parser().parse_args(arguments)
    try:
        if options.table:
            table.write(options.table, options.page)
        if options.seeds:
            diagnose(range(*options.seeds), options.out)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def diagnose(seeds: range, out: Path) -> None:
    """Append the records of the seeds that `out` does not have yet."""
    done = {record["seed"] for record in table.records(out)} if out.is_file() else set()
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("a", encoding="utf-8") as file:
        for seed in seeds:
            if seed not in done:
                file.write(json.dumps(record_of(seed)) + "\n")
                file.flush()


def record_of(seed: int) -> dict[str, Any]:
    """Label and diagnosis of a case; `failure` in the diagnosis where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        machine, label = cases.write(Path(folder), seed)
        setting = {"folder": folder, "machine": machine, "law": run.ESTIMATED}
        start = time.process_time()
        result = run.diagnosis(setting, 0)
    seconds = round(time.process_time() - start, 2)
    return {"seed": seed, "label": label, "result": result, "seconds": seconds}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.third", description=__doc__
    )
    seeds = "diagnose the cases of seeds FIRST to END - 1"
    parser.add_argument("--seeds", type=int, nargs=2, help=seeds)
    out = Path("out/third.jsonl")
    parser.add_argument("--out", type=Path, default=out, help="file of the records")
    parser.add_argument("--table", type=Path, help="file of records to tabulate")
    parser.add_argument("--page", type=Path, default=table.PAGE, help="page to write")
    return parser


if __name__ == "__main__":
    sys.exit(main())
