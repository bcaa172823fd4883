"""Sampling the posterior: independent draws beside emcee and beside NumPy by hand.

    python -m benchmarks.sampling

The readings of the A3 head are the best 60 of the candidates of study `a3_ball_bar`,
those of the hexapod the 80 of `hexapod_ball_bar`, simulated. Every parameter is to have an
effective sample size of 1000. Seconds are processor time on one thread, of the sampling
with its diagnostics and the draws' null directions, without imports; the least of three
runs, of one where it takes longer than 3 s.

By hand are normal proposals about the Laplace approximation of the same density, with
weights until Kish's effective size is 1000, where the noise law is known: what a page of
NumPy does, without null directions, diagnostics or limits of the weights.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import special

import oed
from benchmarks.harness.tables import head, row
from oed import posterior
from oed.posterior import LogDensity, Posterior, Sampler
from pkm_studies import shipped
from pkm_studies.stages import Fitted

Result = TypeVar("Result")
ESS = 1000.0  #: effective sample size of every parameter
REPEATS, LONG_S = 3, 3.0  #: runs, and seconds of a run that is not repeated
#: study, readings by its design, whether the noise law is estimated
CASES = (
    ("a3_ball_bar", 60, False),
    ("a3_ball_bar", 60, True),
    ("hexapod_ball_bar", 80, False),
    ("hexapod_ball_bar", 80, True),
)
COLUMNS = ("study", "law", "sampler", "k", "s", "ESS", "emcee, s", "ESS", "by hand, s")


def fitted(name: str, readings: int, estimate: bool) -> Fitted:
    """The fit of a shipped study's simulated readings."""
    path = shipped.study_path(Path(name))
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    tables["design"]["readings"] = readings
    tables["noise"]["estimate"] = estimate
    del tables["expect"]
    study = oed.build_study(tables, path.parent)
    return oed.identify(oed.simulate(oed.choose_design(study))).state


def draw(state: Fitted, sampler: Sampler, seed: int) -> Posterior:
    """Draws about a fit."""
    readings = state.readings
    rng = np.random.default_rng(seed)
    about = (state.measurement, readings.series, readings.y, state.estimate)
    return posterior.sample(*about, rng, sampler=sampler, ess=ESS)


def draw_by_hand(state: Fitted, seed: int) -> float:
    """Kish's effective size of weighted normal draws."""
    readings, rng = state.readings, np.random.default_rng(seed)
    target = LogDensity(state.measurement, readings.series, readings.y, state.estimate)
    log_weights, count = np.zeros(0), 1200
    while True:
        normal = rng.standard_normal((count, target.dimensions))
        points = target.centre + normal @ target.root.T
        new = target(points) + 0.5 * np.sum(normal**2, axis=1)
        log_weights = np.concatenate([log_weights, new])
        weights = special.softmax(log_weights)
        size = float(1.0 / np.sum(weights**2))
        if size >= ESS:
            return size
        count = int(len(log_weights) * (1.1 * ESS / size - 1.0)) + 50


def time_of(work: Callable[[int], Result]) -> tuple[float, Result]:
    """Least seconds of some runs, by their seeds, and the last result."""
    seconds: list[float] = []
    while len(seconds) < REPEATS:
        start = time.process_time()
        result = work(len(seconds))
        seconds.append(time.process_time() - start)
        if seconds[0] > LONG_S:
            break
    return min(seconds), result


def main() -> None:
    """Print the table."""
    import arviz_stats.base  # noqa: F401  # before the clock runs
    import emcee  # noqa: F401

    print(head(*COLUMNS), flush=True)
    for name, readings, estimate in CASES:
        state = fitted(name, readings, estimate)
        seconds, drawn = time_of(lambda seed, s=state: draw(s, "auto", seed))
        peer, chains = time_of(lambda seed, s=state: draw(s, "emcee", seed))
        by_hand = "-"
        if not estimate:
            least, _ = time_of(lambda seed, s=state: draw_by_hand(s, seed))
            by_hand = f"{least:.3f}"
        sizes = [f"{np.nanmin(each.ess):.0f}" for each in (drawn, chains)]
        law = "estimated" if estimate else "known"
        ours = (f"{drawn.pareto_k:.2f}", f"{seconds:.3f}", sizes[0])
        theirs = (f"{peer:.2f}", sizes[1], by_hand)
        print(row(name, law, drawn.sampler, *ours, *theirs), flush=True)


if __name__ == "__main__":
    main()
