"""Sampling the posterior: independent draws beside emcee, of the same density.

    python -m benchmarks.sampling                    # time, A3 head and a hexapod
    python -m benchmarks.sampling --equal            # means, spreads, quantiles of both
    python -m benchmarks.sampling --readings 5000    # of a long session alone
    python -m benchmarks.sampling --plain            # beside importance sampling by hand

The readings of the A3 head are the best 60 of the candidates of study `a3_ball_bar`,
those of the hexapod the 80 of `hexapod_ball_bar`, simulated; a long session is that of
`benchmarks/long_traces.py`. Every parameter is to have an effective sample size of 1000.
Seconds are processor time on one thread, of the sampling with its diagnostics and the
draws' null directions, without imports; the least of three runs, of one where it takes
longer than 3 s.

`--equal` compares draws that are worth 2000: the largest differences of means, standard
deviations and the 2.5, 50 and 97.5 % quantiles over all parameters, in standard errors of
both samplers together, by kurtosis and density of the draws. The median of the largest
of so many standard normal numbers stands beside them.

`--plain` has normal proposals about the Laplace approximation of the same density, with
weights until Kish's effective size is 1000, where the noise law is known: what a page of
NumPy does, without null directions, diagnostics or limits of the weights.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import argparse
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
from scipy import special, stats

import oed
from benchmarks.long_traces import NOISE, write_readings, write_study
from oed import posterior
from oed.posterior import LogDensity, Posterior, Sampler
from pkm_studies import shipped
from pkm_studies.stages import Fitted

REPEATS, LONG_S = 3, 3.0
#: effective sample size of a comparison; probabilities of its quantiles
EQUAL_ESS, QUANTILES = 2000.0, (0.025, 0.5, 0.975)
#: on either side of a quantile, where the density is measured
AROUND = 0.01
#: study, readings by its design, whether the noise law is estimated
CASES = (
    ("a3_ball_bar", 60, False),
    ("a3_ball_bar", 60, True),
    ("hexapod_ball_bar", 80, False),
    ("hexapod_ball_bar", 80, True),
)


def fitted(name: str, readings: int, estimate: bool) -> Fitted:
    """The fit of a shipped study's simulated readings."""
    path = shipped.study_path(Path(name))
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    tables["design"]["readings"] = readings
    tables["noise"]["estimate"] = estimate
    del tables["expect"]
    study = oed.build_study(tables, path.parent)
    return oed.identify(oed.simulate(oed.choose_design(study))).state


def fitted_session(readings: int, estimate: bool) -> Fitted:
    """The fit of a long session."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        csv = write_readings(folder, readings, False)
        path = write_study(folder, readings, False, NOISE)
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
        tables["noise"]["estimate"] = estimate
        study = oed.build_study(tables, folder)
        return oed.identify(oed.read_readings(study, str(csv))).state


def draw(state: Fitted, sampler: Sampler, seed: int, ess: float) -> Posterior:
    """Draws about a fit."""
    readings = state.readings
    return posterior.sample(
        state.measurement,
        readings.series,
        readings.y,
        state.estimate,
        np.random.default_rng(seed),
        sampler=sampler,
        ess=ess,
    )


def time_of(state: Fitted, sampler: Sampler) -> tuple[float, Posterior]:
    """Least seconds of some runs, and draws."""
    seconds: list[float] = []
    while len(seconds) < REPEATS:
        start = time.process_time()
        drawn = draw(state, sampler, len(seconds), 1000.0)
        seconds.append(time.process_time() - start)
        if seconds[0] > LONG_S:
            break
    return min(seconds), drawn


def time_row(name: str, state: Fitted) -> str:
    """One row of the table of times."""
    seconds, drawn = time_of(state, "auto")
    peer, chains = time_of(state, "emcee")
    law = "estimated" if drawn.noise_names else "known"
    sizes = [f"{np.nanmin(each.ess):.0f}" for each in (drawn, chains)]
    return (
        f"| {name} | {len(state.readings.y)} | {law} | {drawn.sampler} |"
        f" {drawn.pareto_k:.2f} | {seconds:.2f} | {sizes[0]} | {peer:.2f} | {sizes[1]} |"
        f" {peer / seconds:.1f} |"
    )


def plain_draws(state: Fitted, seed: int) -> float:
    """Kish's effective size of weighted normal draws, at least 1000."""
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
        if size >= 1000.0:
            return size
        count = int(len(log_weights) * (1100.0 / size - 1.0)) + 50


def plain_row(name: str, state: Fitted) -> str:
    """One row of the table beside plain importance sampling."""
    ours, theirs = [], []
    for seed in range(REPEATS):
        start = time.process_time()
        draw(state, "auto", seed, 1000.0)
        middle = time.process_time()
        plain_draws(state, seed)
        ours.append(middle - start)
        theirs.append(time.process_time() - middle)
    ratio = min(ours) / min(theirs)
    return f"| {name} | {min(ours):.3f} | {min(theirs):.3f} | {ratio:.1f} |"


def figures(drawn: Posterior) -> tuple[np.ndarray, np.ndarray]:
    """Mean, standard deviation and quantiles (5, n), and their standard errors."""
    pooled, sd = drawn.pooled, drawn.sd
    values = [drawn.theta, sd, *np.quantile(pooled, QUANTILES, axis=0)]
    with np.errstate(invalid="ignore"):
        kurtosis = np.mean((pooled - drawn.theta) ** 4, axis=0) / sd**4
    errors = [sd, sd * np.sqrt((kurtosis - 1.0) / 4.0)]
    for p in QUANTILES:
        low, high = np.quantile(pooled, (p - AROUND, p + AROUND), axis=0)
        errors.append(np.sqrt(p * (1.0 - p)) * (high - low) / (2.0 * AROUND))
    # draws of emcee are thinned: they are worth no more than their number
    worth = np.minimum(drawn.ess, len(pooled))
    return np.array(values), np.array(errors) / np.sqrt(worth)


def equal_row(name: str, state: Fitted) -> str:
    """One row of the table of differences."""
    pair = [figures(draw(state, s, 5, EQUAL_ESS)) for s in ("auto", "emcee")]
    (ours, error), (theirs, other) = pair
    free = error[0] > 0.0
    off = (np.abs(ours - theirs) / np.hypot(error, other))[:, free]
    expected = stats.norm.isf(0.5 * (1.0 - 0.5 ** (1.0 / free.sum())))
    worst = " | ".join(f"{value:.1f}" for value in off.max(axis=1))
    law = "estimated" if state.estimate.noise_posterior else "known"
    return f"| {name} | {law} | {free.sum()} | {worst} | {expected:.1f} |"


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--equal", action="store_true")
    parser.add_argument("--readings", type=int)
    parser.add_argument("--plain", action="store_true")
    options = parser.parse_args()
    import arviz_stats.base  # noqa: F401  # before the clock runs
    import emcee  # noqa: F401

    if options.plain:
        print("| study | s | by hand, s | ratio |\n| --- | --: | --: | --: |")
        for name, readings, estimate in CASES:
            if not estimate:
                print(plain_row(name, fitted(name, readings, estimate)), flush=True)
        return
    if options.equal:
        print(
            "| study | law | parameters | mean | sd | 2.5 % | 50 % | 97.5 % | usual |"
        )
        print("| --- | --- | --: | --: | --: | --: | --: | --: | --: |")
    else:
        print(
            "| study | readings | law | sampler | k | s | ESS | emcee, s | ESS | ratio |"
        )
        print("| --- | --: | --- | --- | --: | --: | --: | --: | --: | --: |")
    row = equal_row if options.equal else time_row
    if options.readings:
        for estimate in (False, True):
            state = fitted_session(options.readings, estimate)
            print(row("long session", state), flush=True)
        return
    for name, readings, estimate in CASES:
        print(row(name, fitted(name, readings, estimate)), flush=True)


if __name__ == "__main__":
    main()
