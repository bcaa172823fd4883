"""Random machines without a gap: `python -m benchmarks.random_machines run`, `table`
or `scaling`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
from pathlib import Path

from benchmarks.random_machines import case, run, scaling, table

OUT = Path("out/random_machines.jsonl")


def main() -> None:
    """Diagnose machines, print the table of those that were, or scale some."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task", choices=("run", "table", "scaling"))
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--count", type=int, default=136, help="how many machines")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--records", type=Path, default=OUT, help="file of the records")
    given = parser.parse_args()
    if given.task == "scaling":
        _scale()
        return
    if given.task == "run":
        numbers = range(given.first, given.first + given.count)
        run.run(numbers, given.seed, given.records)
    print(table.markdown(run.load(given.records)))


def _scale() -> None:
    """Print how much a thousandfold length changes probabilities."""
    print("| machine | gap | largest change |")
    print("| --- | --- | --: |")
    for model, gap, kind, seed in scaling.CASES:
        drawn = case.draw_with_gap(model, gap, kind, seed)
        change = scaling.largest(*scaling.changes(drawn))
        print(f"| `{model}` | {gap or 'none'} | {change:.4f} |", flush=True)


main()
