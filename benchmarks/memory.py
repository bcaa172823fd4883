"""Peak memory and time of choosing 30 of a million rows, and of reading a million lines.

    python -m benchmarks.memory

Memory is over that of the rows (1,000,000 x 21 normal numbers), or over the size of the file.
Lines of a ball bar on the A3 head become series of poses; the limit of a session's readings
is lifted for them. Each job runs in a process of its own. What the process holds before it
draws the rows (Python, NumPy, this project) is subtracted. Seconds are processor time on one
thread.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.harness.processes import alone, peak
from benchmarks.harness.tables import head, row
from oed import dataset
from oed.dataset import table
from oed.design import choose, relax
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head

ROWS, COLUMNS, SIZE = 1_000_000, 21, 30  #: rows, their columns, and how many are chosen
RELAXATION, CHOICE = "relaxation", "choice with its certificate"
LINES = (10_000, 100_000, 1_000_000)
HEADER = "setup,run,order,z_mm,psi_deg,theta_deg,length_mm,time_min,direction\n"


def choose_rows(job: str) -> str:
    """Row of the table of a job."""
    before = peak()
    rows = np.random.default_rng(0).standard_normal((ROWS, COLUMNS))
    start = time.process_time()
    if job == RELAXATION:
        relax(rows, float(SIZE))
    else:
        choose(rows, SIZE, np.random.default_rng(1))
    return _figures(job, rows.nbytes, before, start)


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


def read_lines(path: Path) -> str:
    """Row of the table of a file of readings."""
    setup = mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0))
    measurement = Measurement(a3_head.machine, [setup])
    before, start = peak(), time.process_time()
    with mock.patch.multiple(table, MAX_READINGS=10**9, MAX_BYTES=10**12):
        readings = dataset.load(path, measurement)
    job = f"{len(readings)} lines"
    return _figures(job, path.stat().st_size, before, start)


def _figures(job: str, size: int, before: int, start: float) -> str:
    seconds = time.process_time() - start
    ratio = (peak() - before) / size
    return row(job, f"{size / 1e6:.1f}", f"{ratio:.2f}", f"{seconds:.1f}")


def main() -> None:
    """Print the table."""
    print(head("job", "rows or file, MB", "peak over it", "s"), flush=True)
    for job in (RELAXATION, CHOICE):
        print(alone(choose_rows, job), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "readings.csv")
        for count in LINES:
            write_lines(path, count)
            print(alone(read_lines, path), flush=True)


if __name__ == "__main__":
    main()
