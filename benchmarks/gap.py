"""Times of one diagnosis, of a greedy alternative and of a sampling one.

    python benchmarks/gap.py [--effect backlash] [--walkers 64] [--steps 2000]

All have the same library, readings and noise.

Readings: the A3 of the blind benchmark by its full plan (720 readings), one effect of
sqrt(lambda) = 10, white noise, all covariates. Rows: `diagnose` (all effects, singles
to triples, unknown processes, noise laws, where, how far); its search alone; forward
selection by BIC over the same columns; and emcee on the coefficients of the likeliest
pair of effects alone, one form of each, noise known. A sampler needs that time for one
form of one of the sets of effects that the search compares, and gives no evidence. Wall
and processor seconds are of one run, on one BLAS thread: two threads on busy cores slow
these small solves down tenfold.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import dataclasses
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import emcee
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.blind import loading
from benchmarks.blind.generator import (
    cases,
    effects,
    noise,
    plans,
    scene,
    severity,
    write,
)
from benchmarks.blind.generator.effects.thermal import climate
from benchmarks.blind.stepwise import stepwise
from oed.gap import procedure as diagnose
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Search
from oed.gap.cause.searches import searches
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library
from oed.model.effect import Effect


@dataclasses.dataclass(frozen=True)
class Timing:
    """A line of the table.

    method       name of the method
    wall         seconds on the wall
    processor    seconds of the processor
    answer       in words
    """

    method: str
    wall: float
    processor: float
    answer: str


def readings(name: str, seed: int) -> tuple[GapProblem, Sequence[Effect]]:
    """The problem of a virtual A3 with one effect, and the library."""
    rng = np.random.default_rng(seed)
    plan = dataclasses.replace(
        plans.draw(rng, "a3", "full"),
        columns=("time_s", "direction", "feed_mm_min", "payload_N", "repeat"),
    )
    base = scene.draw(rng, plan)
    stage = effects.Stage(plan, base.motion, base.layout, climate(rng, plan))
    law, group = noise.Law(name="white"), noise.grouping(plan, base.layout)
    metric = severity.Metric(noise.covariance(law, group), base.J, base.prior)
    effect = effects.KNOWN[name](rng, stage)
    start = 10.0 / metric.size(base.response(effect.push(1e-7))) * 1e-7
    size = severity.amplitude(
        lambda a: base.read(effect.push(a)) - base.y, metric.size, 10.0, start
    )
    clean = base.read(effect.push(size))
    sized = (cases.Sized(effect, True, 10.0, size, clean - base.y),)
    y = clean + noise.sample(rng, law, group)
    case = cases.Case(
        "one",
        0,
        "single",
        base,
        stage,
        law,
        group,
        metric,
        sized,
        clean,
        y,
        (seed, 0, 0),
    )
    text = write.table(case).to_csv(index=False, lineterminator="\n")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "one.csv"
        file.write_text(text, encoding="utf-8", newline="")
        one = loading.Case("one", plan.study, "one.csv")
        problem = loading.prepare(Path(folder), one)
    return problem, loading.bench(plan.study).effects


def time_once(method: str, job: Callable[[], str]) -> Timing:
    """A job, run once."""
    wall, processor = time.perf_counter(), time.process_time()
    answer = job()
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    return Timing(method, wall, processor, answer)


def sample(problem: GapProblem, search: Search, walkers: int, steps: int) -> str:
    """emcee over the coefficients of the likeliest pair of effects.

    Coefficients have the prior N(0, size^2); the parameters are marginalised.
    """
    pairs = (h for h in search.run() if len(h.effects) == 2 and not h.unknown)
    pair = next(pairs)
    columns = pair.columns(search.library, search.processes)
    metric, count = Metric(problem, search.law), columns.shape[1]
    gram = metric.gram(columns, columns) + np.eye(count)
    projected = metric.gram(columns, problem.residual[:, None])[:, 0]

    def log_posterior(b: np.ndarray) -> np.ndarray:
        energy = np.einsum("wi,ij,wj->w", b, gram, b)
        return np.asarray(b @ projected - 0.5 * energy)

    walkers = max(walkers, 2 * count + 2)
    rng = np.random.default_rng(1)
    sampler = emcee.EnsembleSampler(walkers, count, log_posterior, vectorize=True)
    sampler.random_state = np.random.RandomState(1).get_state()  # what emcee takes
    sampler.run_mcmc(rng.standard_normal((walkers, count)), steps)
    each = sampler.get_autocorr_time(quiet=True).max()
    return (
        f"{' + '.join(pair.effects)}, {count} coefficients,"
        f" {walkers * steps / each:.0f} independent draws"
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--effect", default="backlash", choices=effects.known_on("a3"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--walkers", type=int, default=64)
    parser.add_argument("--steps", type=int, default=2000)
    options = parser.parse_args()
    problem, known = readings(options.effect, options.seed)
    searched: list[Search] = []

    def search() -> str:
        searched.extend(searches(problem, known))
        best, *others = compare(searched)
        effects_named = " + ".join(best.effects) or "none"
        return f"{effects_named}, of {len(others) + 1} sets of effects"

    def greedy() -> str:
        names = stepwise(problem, library.build(problem, known))
        return " + ".join(names) or "none"

    def sampling() -> str:
        return sample(problem, searched[0], options.walkers, options.steps)

    timings = [
        time_once("diagnose", lambda: diagnosis(problem, known)),
        time_once("its search alone", search),
        time_once("stepwise BIC", greedy),
        time_once("emcee, one pair", sampling),
    ]
    print(
        f"{len(problem)} readings, {len(known)} effects, {options.effect} acts with"
        " sqrt(lambda) = 10\n"
    )
    report(timings)
    return 0


def diagnosis(problem: GapProblem, known: Sequence[Effect]) -> str:
    """The best answer of the whole diagnosis, in words."""
    result = diagnose.diagnose(problem, known, np.random.default_rng(1))
    first = result.answers[0]
    names = [" or ".join(members) for members in first.classes]
    if "unknown" in first.effects:
        names.append("unknown")
    return f"{' + '.join(names) or 'none'} ({first.probability:.2f})"


def report(timings: Sequence[Timing]) -> None:
    """Print the table; ratios are against the first line."""
    print("| method | wall, s | processor, s | ratio | answer |")
    print("| --- | --: | --: | --: | --- |")
    for t in timings:
        ratio = t.processor / timings[0].processor
        times = f"{t.wall:.2f} | {t.processor:.2f} | {ratio:.2f}"
        print(f"| {t.method} | {times} | {t.answer} |")


if __name__ == "__main__":
    sys.exit(main())
