"""Peak memory and time of choosing 30 of a million rows, over the memory of the rows.

    python benchmarks/memory.py                  # 1,000,000 x 21 normal rows
    python benchmarks/memory.py --count 200000
    python benchmarks/memory.py --readings       # 10,000 to 1,000,000 lines of readings

With `--readings`, lines of a ball bar on the A3 head become series of poses, and memory
is that over the size of the file. The limit of a session's readings is lifted for it.

Each job runs in a process of its own. What the process holds before it draws the rows
(Python, NumPy, this project) is subtracted. Seconds are processor time on one thread.
"""

from __future__ import annotations

import os

from oed.instrument import mount

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np

from oed import dataset
from oed.dataset import table
from oed.design import choose, relax
from oed.measurement import Measurement
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head

COLUMNS, SIZE = 21, 30
JOBS = ("relaxation", "choice with its certificate")
LINES = (10_000, 100_000, 1_000_000)
HEADER = "setup,run,order,z_mm,psi_deg,theta_deg,length_mm,time_min,direction\n"


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
        relax(rows, float(SIZE))
    else:
        choose(rows, SIZE, np.random.default_rng(1))
    seconds = time.process_time() - start
    ratio = (peak() - before) / rows.nbytes
    print(f"| {job} | {rows.nbytes / 1e6:.0f} | {ratio:.2f} | {seconds:.1f} |")


def write_lines(path: Path, count: int) -> None:
    """A file of readings in eight runs, of poses all over the workspace."""
    rng = np.random.default_rng(0)
    with path.open("w", encoding="utf-8") as file:
        file.write(HEADER)
        for k in range(count):
            z, turn, tilt = rng.random(3) * (80.0, 360.0, 1.0)
            file.write(
                f"cup,run {k % 8},{k // 8 + 1},{1146.0 + z:.4f},{turn:.4f},{tilt:.6f},"
                f"{300.0 + 1e-3 * rng.standard_normal():.6f},{k / 600.0:.5f},1\n"
            )


def read(path: Path) -> None:
    """Print one row of the table of readings."""
    setup = mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0))
    measurement = Measurement(a3_head.machine, [setup])
    before, start = peak(), time.process_time()
    with mock.patch.multiple(table, MAX_READINGS=10**9, MAX_BYTES=10**12):
        readings = dataset.load(path, measurement)
    seconds = time.process_time() - start
    size = path.stat().st_size
    ratio = (peak() - before) / size
    print(f"| {len(readings)} | {size / 1e6:.1f} | {ratio:.1f} | {seconds:.2f} |")


def read_all() -> None:
    """Print the table of readings."""
    print("| lines | file, MB | peak over file | s |")
    print("| --: | --: | --: | --: |")
    sys.stdout.flush()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "readings.csv")
        for count in LINES:
            write_lines(path, count)
            subprocess.run([sys.executable, __file__, "--file", str(path)], check=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1_000_000, help="of rows")
    parser.add_argument("--job", choices=JOBS, help="this one, in this process")
    parser.add_argument("--readings", action="store_true", help="lines of readings")
    parser.add_argument("--file", type=Path, help="read it, in this process")
    arguments = parser.parse_args()
    if arguments.file is not None:
        read(arguments.file)
        return
    if arguments.readings:
        read_all()
        return
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
