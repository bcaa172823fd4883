"""One diagnosis, timed beside a greedy and a sampling alternative on the same library,
readings and noise.

    python benchmarks/gap.py [--effect backlash] [--walkers 64] [--steps 2000]

Readings: the A3 of the blind benchmark by its full plan (720 readings), one effect of
sqrt(lambda) = 10, white noise, all covariates. Rows: `diagnose` (all effects, singles
to triples, unknown processes, noise laws, where, how far); its search alone; forward
selection by BIC over the same columns; and emcee on the coefficients of the likeliest
pair of effects alone, one form of each, noise known. That is what a sampler needs for
one form of one of the sets of effects that the search compares, and it gives no
evidence. Wall and processor seconds of one run, on one BLAS thread: two threads on busy
cores slow these small solves down tenfold.
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

from benchmarks.blind import baselines, loading
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
from oed.effect import Effect
from oed.gap import diagnose
from oed.gap.cause import which
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library


@dataclasses.dataclass(frozen=True)
class Row:
    """A line of the table: seconds on the wall and of the processor, what was answered."""

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
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "one.csv").write_text(
            write.table(case).to_csv(index=False, lineterminator="\n"),
            encoding="utf-8",
            newline="",
        )
        problem = loading.prepared(
            Path(folder), loading.Case("one", plan.study, "one.csv")
        )
    return problem, loading.bench(plan.study).effects


def timed(method: str, job: Callable[[], str]) -> Row:
    """A job, run once."""
    wall, processor = time.perf_counter(), time.process_time()
    answer = job()
    return Row(
        method, time.perf_counter() - wall, time.process_time() - processor, answer
    )


def sampled(problem: GapProblem, search: which.Search, walkers: int, steps: int) -> str:
    """emcee over the coefficients of the likeliest pair of effects, prior N(0, size^2),
    parameters marginalised.
    """
    pair = next(h for h in search.run() if len(h.effects) == 2 and not h.unknown)
    parts = [
        s * search.library.columns[:, search.columns_of(a)]
        for a, s in zip(pair.atoms, pair.sizes, strict=True)
    ]
    columns, metric = np.hstack(parts), Metric(problem, search.law)
    gram = metric.gram(columns, columns) + np.eye(columns.shape[1])
    told = metric.gram(columns, problem.residual[:, None])[:, 0]
    count = columns.shape[1]
    walkers = max(walkers, 2 * count + 2)
    rng = np.random.default_rng(1)
    sampler = emcee.EnsembleSampler(
        walkers,
        count,
        lambda b: b @ told - 0.5 * np.einsum("wi,ij,wj->w", b, gram, b),
        vectorize=True,
    )
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
    said = parser.parse_args()
    problem, known = readings(said.effect, said.seed)
    made: list[which.Search] = []

    def whole() -> str:
        found = diagnose.diagnose(problem, known, np.random.default_rng(1))
        first = found.answers[0]
        named = [" or ".join(c) for c in first.classes] + ["unknown"] * (
            "unknown" in first.effects
        )
        return f"{' + '.join(named) or 'none'} ({first.probability:.2f})"

    def search() -> str:
        made.extend(diagnose.searches(problem, known))
        tried = which.compare(made)
        return (
            f"{' + '.join(tried[0].effects) or 'none'}, of {len(tried)} sets of effects"
        )

    def greedy() -> str:
        return (
            " + ".join(baselines.stepwise(problem, library.build(problem, known)))
            or "none"
        )

    rows = [
        timed("diagnose", whole),
        timed("its search alone", search),
        timed("stepwise BIC", greedy),
        timed(
            "emcee, one pair",
            lambda: sampled(problem, made[0], said.walkers, said.steps),
        ),
    ]
    print(
        f"{len(problem)} readings, {len(known)} effects, {said.effect} acts with"
        " sqrt(lambda) = 10\n"
    )
    print(
        "| method | wall, s | processor, s | ratio | answer |\n| --- | --: | --: | --:"
        " | --- |"
    )
    for r in rows:
        print(
            f"| {r.method} | {r.wall:.2f} | {r.processor:.2f} |"
            f" {r.processor / rows[0].processor:.2f} | {r.answer} |"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
