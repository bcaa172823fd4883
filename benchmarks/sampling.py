"""Time of sampling the posterior of the A3 head from 60 ball-bar readings.

    python benchmarks/sampling.py

The readings are the best 60 of the candidates of study `a3_ball_bar`, simulated. Every
parameter is to have an effective sample size of 1000. Seconds are processor time on one
thread, of the sampling with its diagnostics and the draws' null directions, without
imports.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import time
import tomllib
from pathlib import Path

import oed
from oed.posterior.posterior import import_samplers
from pkm_studies.study import shipped

READINGS, REPEATS = 60, 3


def main() -> None:
    """Print one line."""
    path = shipped.study_path(Path("a3_ball_bar"))
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    tables["design"]["readings"] = READINGS
    del tables["expect"]
    study = oed.build_study(tables, path.parent)
    estimate = oed.identify(oed.simulate(oed.choose_design(study)))
    import_samplers()
    seconds = []
    for _ in range(REPEATS):
        start = time.process_time()
        posterior = oed.sample(estimate).section
        seconds.append(time.process_time() - start)
    sizes = [marginal.ess for marginal in posterior.marginals.values()]
    least = min(size for size in sizes if size is not None)
    print(f"{min(seconds):.1f} s, least effective sample size {least:.0f}")


if __name__ == "__main__":
    main()
