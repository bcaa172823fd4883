"""Time and memory of a diagnosis of long traces, with a gap and without one.

    python -m benchmarks.long_traces                      # 720, 5000, 20000 readings
    python -m benchmarks.long_traces --readings 5000

Readings: the A3 head with a ball bar, two circles both ways (four runs), ten readings a
second, all covariates. The bar's noise of 0.5 um has a share of 0.3 that is correlated over
8 readings, which no study states; each run's level repeats to 0.2 um. The gap is 2 um of
backlash in one leg.

Each row is a process of its own. The fit reads the file and identifies. Seconds are
processor time on one BLAS thread; memory is the process' peak, with all libraries.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from benchmarks.harness import tables
from benchmarks.harness.diagnosis import prepare
from benchmarks.harness.noise import autoregression
from benchmarks.harness.processes import alone, peak
from oed.gap import diagnose
from pkm_studies import stages, study

RUNS = 4
NOISE, LEVEL = 0.5, 0.2  #: standard deviations of a reading and of a run's level, um
#: share of the variance that is correlated, and over how many readings
CORRELATED, LENGTH = 0.3, 8.0
STUDY = """\
schema = 1
name = "long_traces"
seed = 2

[machine]
model = "a3_head"

[[setup]]
name = "cup"
instrument = "ball_bar"
length_mm = 300.0
teach = {{ z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }}
both_directions = true
average = false

[noise]
length_um = {noise}

[design]

[[design.reference]]
name = "circles"
setup = "cup"
z_mm = [1146.0, 1226.0]
psi_deg = {{ from = 0.0, to = 360.0, count = {count}, endpoint = false }}
theta = "hold"
runs_by = "z"

[readings]
simulate = true
draw = true

[posterior]
enabled = false

[gap.conditions]
start_min = 10.0
pause_s = 300.0
reading_s = 0.1
feed_mm_min = 1000.0
{acting}
"""
ACTING = """
[[gap.acting]]
effect = "backlash"
coefficients = { "leg 3" = 0.4 }
"""


class Diagnosed(NamedTuple):
    """Seconds of the fit and of the diagnosis, peak memory (MiB), and the answer."""

    fit: float
    seconds: float
    memory: float
    answer: str


def write_study(folder: Path, readings: int, gap: bool, noise: float) -> Path:
    """The study of so many readings, with a noise in um, in a folder."""
    acting = ACTING if gap else ""
    text = STUDY.format(count=readings // RUNS, noise=noise, acting=acting)
    path = folder / "long_traces.study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def write_readings(folder: Path, readings: int, gap: bool) -> Path:
    """Readings of the virtual head with correlated noise, as a CSV in a folder."""
    white = NOISE * np.sqrt(1.0 - CORRELATED)
    path = folder / "long_traces.csv"
    simulated = study.Study.load(write_study(folder, readings, gap, white))
    stages.simulate_study(simulated, path)
    table, rng = pd.read_csv(path), np.random.default_rng(5)
    for members in table.groupby("run", sort=False).indices.values():
        normal = rng.standard_normal(len(members))
        correlated = autoregression(normal, np.exp(-1.0 / LENGTH))
        error = NOISE * np.sqrt(CORRELATED) * correlated
        error += LEVEL * rng.standard_normal()
        table.loc[members, "length_mm"] += 1e-3 * error
    table.to_csv(path, index=False)
    return path


def diagnose_once(readings: int, gap: bool) -> Diagnosed:
    """The diagnosis of a session, with or without a gap."""
    with tempfile.TemporaryDirectory() as folder:
        csv = write_readings(Path(folder), readings, gap)
        stated = write_study(Path(folder), readings, False, NOISE)
        start = time.process_time()
        problem, effects = prepare(stated, csv)
    middle = time.process_time()
    result = diagnose(problem, effects, np.random.default_rng(1))
    seconds = time.process_time() - middle
    first = result.answers[0]
    answer = " + ".join(first.effects) or "no gap"
    answer = f"{answer} ({first.probability:.2f})"
    return Diagnosed(middle - start, seconds, peak() / 2**20, answer)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.long_traces")
    parser.add_argument("--readings", type=int, nargs="+", default=[720, 5000, 20000])
    columns = ("readings", "acts", "fit, s", "diagnosis, s", "MiB", "answer")
    print(tables.head(*columns), flush=True)
    for readings in parser.parse_args().readings:
        for acts, gap in (("backlash", True), ("nothing", False)):
            one = alone(diagnose_once, readings, gap)
            figures = (f"{one.fit:.1f}", f"{one.seconds:.1f}", f"{one.memory:.0f}")
            print(tables.row(readings, acts, *figures, one.answer), flush=True)


if __name__ == "__main__":
    main()
