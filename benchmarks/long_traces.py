"""Time and memory of a diagnosis of long traces, with a gap and without one.

    python -m benchmarks.long_traces                      # 720, 5000, 20000 readings
    python -m benchmarks.long_traces --readings 5000 --law known

Readings: the A3 head with a ball bar, two circles both ways (four runs), ten readings a
second, all covariates. The bar's noise of 0.5 um has a share of 0.3 that is carried
along over 8 readings, which no study states; each run's level repeats to 0.2 um. The gap
is 2 um of backlash in one leg. The diagnosis estimates the noise law, or knows it
(`--law known`).

Each row is a process of its own. The fit reads the file and identifies. Seconds are
processor time on one BLAS thread; memory is the process' peak, with all libraries.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.harness.diagnosis import prepare
from benchmarks.memory import peak
from oed.gap import GapProblem, diagnose
from oed.noise import NoiseLaw
from pkm_studies import stages, study

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded


RUNS, NOISE, CARRIED, REACH, LEVEL = 4, 0.5, 0.3, 8.0, 0.2
STUDY = """\
schema = 1
name = "long_traces"
title = "A3 head, long traces"
question = "What is left over when this machine has been calibrated?"
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


def write_study(folder: Path, readings: int, gap: bool, noise: float) -> Path:
    """The study of so many readings, with a noise in um, in a folder."""
    text = STUDY.format(
        count=readings // RUNS, noise=noise, acting=ACTING if gap else ""
    )
    path = folder / "long_traces.study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def write_readings(folder: Path, readings: int, gap: bool) -> Path:
    """Readings of the virtual head with correlated noise, as a CSV in a folder."""
    single = NOISE * np.sqrt(1.0 - CARRIED)
    path = folder / "long_traces.csv"
    stages.simulate_study(
        study.Study.load(write_study(folder, readings, gap, single)), path
    )
    table, rng = pd.read_csv(path), np.random.default_rng(5)
    for members in table.groupby("run", sort=False).indices.values():
        error = NOISE * np.sqrt(CARRIED) * carried_along(len(members), rng)
        error += LEVEL * rng.standard_normal()
        table.loc[members, "length_mm"] += 1e-3 * error
    table.to_csv(path, index=False)
    return path


def carried_along(count: int, rng: np.random.Generator) -> np.ndarray:
    """An error (count,) of standard deviation 1 that is carried along a run."""
    white, decay = rng.standard_normal(count), np.exp(-1.0 / REACH)
    error = white.copy()
    for k in range(1, count):
        error[k] = decay * error[k - 1] + np.sqrt(1.0 - decay**2) * white[k]
    return error


def known_law(problem: GapProblem) -> NoiseLaw:
    """The law that the readings were drawn with."""
    parts = {"correlated": CARRIED, "reach": REACH, "level": LEVEL / NOISE}
    arrays = {name: np.array([size]) for name, size in parts.items()}
    return NoiseLaw(dataclasses.replace(problem.stated_law.law, **arrays))


def diagnose_once(readings: int, gap: bool, law: str) -> tuple[float, float, str]:
    """Processor seconds of reading and fit, and of the diagnosis; its answer in words."""
    with tempfile.TemporaryDirectory() as folder:
        csv = write_readings(Path(folder), readings, gap)
        stated = write_study(Path(folder), readings, False, NOISE)
        start = time.process_time()
        problem, effects = prepare(stated, csv)
    fit, start = time.process_time() - start, time.process_time()
    known = known_law(problem) if law == "known" else None
    result = diagnose(problem, effects, np.random.default_rng(1), law=known)
    seconds = time.process_time() - start
    first = result.answers[0]
    answer = " + ".join(first.effects) or "no gap"
    return fit, seconds, f"{answer} ({first.probability:.2f})"


def row(readings: int, gap: bool, law: str) -> str:
    """One row of the table."""
    fit, seconds, answer = diagnose_once(readings, gap, law)
    acts, memory = "backlash" if gap else "nothing", peak() / 2**20
    figures = f"{fit:.1f} | {seconds:.1f} | {memory:.0f}"
    return f"| {readings} | {acts} | {figures} | {answer} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--readings", type=int, nargs="+", default=[720, 5000, 20000])
    parser.add_argument("--law", choices=("estimated", "known"), default="estimated")
    parser.add_argument("--row", choices=("gap", "none"), help="in this process")
    options = parser.parse_args()
    if options.row is not None:
        gap = options.row == "gap"
        print(row(options.readings[0], gap, options.law))
        return
    print("| readings | acts | fit, s | diagnosis, s | MiB | answer |")
    print("| --: | --- | --: | --: | --: | --- |")
    sys.stdout.flush()
    for readings in options.readings:
        for case in ("gap", "none"):
            arguments = ["--readings", str(readings), "--law", options.law]
            module = ["-m", "benchmarks.long_traces"]
            command = [sys.executable, *module, *arguments, "--row", case]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
