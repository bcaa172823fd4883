"""Peak memory and time of choosing 30 of a million rows, over the memory of the rows.

    python benchmarks/memory.py                  # 1,000,000 x 21 normal rows
    python benchmarks/memory.py --count 200000

Each job runs in a process of its own. What the process holds before it draws the rows
(Python, NumPy, this project) is subtracted. Seconds are processor time on one thread.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import argparse
import subprocess
import sys
import time

import numpy as np

from oed.design import exchange, relaxation

COLUMNS, SIZE = 21, 30
JOBS = ("relaxation", "choice with its certificate")


def peak() -> int:
    """Peak memory of this process, bytes. Raises ImportError where there is no POSIX."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def run(job: str, count: int) -> None:
    """Print one row of the table."""
    before = peak()
    rows = np.random.default_rng(0).standard_normal((count, COLUMNS))
    start = time.process_time()
    if job == JOBS[0]:
        relaxation.relax(rows, float(SIZE))
    else:
        exchange.choose(rows, SIZE, np.random.default_rng(1))
    seconds = time.process_time() - start
    ratio = (peak() - before) / rows.nbytes
    print(f"| {job} | {rows.nbytes / 1e6:.0f} | {ratio:.2f} | {seconds:.1f} |")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1_000_000, help="of rows")
    parser.add_argument("--job", choices=JOBS, help="this one, in this process")
    arguments = parser.parse_args()
    if arguments.job is not None:
        run(arguments.job, arguments.count)
        return
    print("| job | rows, MB | peak over rows | s |")
    print("| --- | --: | --: | --: |")
    sys.stdout.flush()
    for job in JOBS:
        options = ["--job", job, "--count", str(arguments.count)]
        subprocess.run([sys.executable, __file__, *options], check=True)


if __name__ == "__main__":
    main()
