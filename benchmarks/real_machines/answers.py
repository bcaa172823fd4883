"""Compensation by the best answer of a diagnosis, and by the mixture over all answers.

    python -m benchmarks.real_machines.answers planar --sizes 0 6 10 --seeds 0 20 --out F.jsonl
    python -m benchmarks.real_machines.answers --table F.jsonl

Machines are those of `benchmarks.real_machines`: healthy, with one effect of a size beside
(0: none). Each is diagnosed; judged is the error of the tool point at the session's poses,
free of its best rigid motion, and whether its intervals hold.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.real_machines import world
from benchmarks.real_machines.__main__ import judge, slopes, tool_shifts
from oed import posterior
from oed.base import Array
from oed.corrected import (
    AnswerFits,
    AnswerMixture,
    CorrectedEstimate,
    EffectReadings,
    estimate_with_effects,
    with_constants,
)
from oed.effects import ExpectedColumns, absorbing_shift, expected_columns
from oed.estimation import identify
from oed.gap import procedure
from oed.gap.data import problem as problems
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem

#: draws of what is known of a machine that are judged
DRAWS = 400
#: what is compared, with its name in the table
KINDS = {
    "geometry": "geometry, no gap",
    "best": "best answer, geometry alone",
    "mixture": "mixture, geometry alone",
    "best_effects": "best answer, its effects corrected",
    "best_effects_mixed": "the same, intervals of the mixture",
}


class Known(NamedTuple):
    """Draws of a machine: parameters (m, n), displacements (m, rows, 3) by effects."""

    theta: Array
    shifts: Array


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "machine", nargs="?", choices=("a3", "planar", "delta", "hexapod")
    )
    parser.add_argument("--sizes", type=float, nargs="+", default=[0.0, 6.0, 10.0])
    parser.add_argument("--seeds", type=int, nargs=2, default=[0, 20])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    if options.table is not None:
        print(table([json.loads(line) for line in options.table.open()]))
        return
    for seed in range(*options.seeds):
        for size in options.sizes:
            record = one(options.machine, size, seed)
            with options.out.open("a") as file:
                file.write(json.dumps(record) + "\n")


def _named(mixture: AnswerMixture) -> list[tuple[str, float]]:
    """Each answer's effects, and its probability."""
    return [
        ("+".join(a.effects) + "unseen" * a.unseen, a.probability)
        for a in mixture.answers
    ]


def one(machine: str, size: float, seed: int) -> dict[str, Any]:
    """One machine: diagnosed, fitted by each answer, and judged."""
    with tempfile.TemporaryDirectory() as folder:
        bench = world.draw(machine, size, "healthy", seed, Path(folder))
    record: dict[str, Any] = dict(machine=machine, size=size, seed=seed, **bench.case)
    rng = np.random.default_rng([seed, round(size)])
    started = time.process_time()
    problem = problems.prepare(
        bench.measurement,
        bench.series,
        bench.y,
        bench.covariates,
        gravity=bench.gravity,
    )
    diagnosis = procedure.explain_residuals(problem, bench.effects, rng)
    record["seconds_diagnosis"] = time.process_time() - started
    started = time.process_time()
    alone = identify(bench.measurement, problem.series, bench.y, estimate_noise=True)
    given = EffectReadings(
        bench.measurement, problem.series, bench.y, bench.covariates, bench.gravity
    )
    corrected = _corrected(bench, given, diagnosis, alone.theta)
    record["seconds_best"] = time.process_time() - started
    started = time.process_time()
    fits = AnswerFits(
        readings=given,
        effects=bench.effects,
        allowed=expected_columns(problem, bench.effects),
        estimate_noise=True,
        rng=rng,
        corrected=corrected,
    )
    mixture = fits.fit(diagnosis.answers, diagnosis.contents, alone)
    assert mixture is not None  # some answer is likely enough, and is fitted
    record["seconds_mixture"] = time.process_time() - started
    record["verdict"], record["rest"] = diagnosis.verdict, mixture.rest
    record["answers"] = _named(mixture)
    nothing = posterior.draw_approximation(
        bench.measurement, problem.series, bench.y, alone, rng, DRAWS
    )
    still = np.zeros((len(nothing.theta), *bench.shift.shape))
    geometry = Known(nothing.theta, still)
    drawn = mixture.draw(rng, DRAWS)
    mixed = Known(
        drawn.theta, _shifts(bench, problem, drawn.columns, drawn.coefficients)
    )
    best, best_mean = geometry, alone.theta
    if corrected is not None:
        best_mean = corrected.estimate.theta[: corrected.parameters]
        best = _of_best(bench, problem, corrected, rng)
    record["geometry"] = judge(bench, alone.theta, *geometry)
    record["best"] = judge(bench, best_mean, *best)
    record["mixture"] = judge(bench, _absorbing(bench, mixture.mean, mixed), *mixed)
    record["best_absorbing"] = judge(bench, _absorbing(bench, best_mean, best), *best)
    record["mixture_mean"] = judge(bench, mixture.mean, *mixed)
    by_effects = best.shifts.mean(axis=0)
    record["best_effects"] = judge(bench, best_mean, *best, by_effects)
    record["best_effects_mixed"] = judge(bench, best_mean, *mixed, by_effects)
    return record


def _corrected(
    bench: world.Bench, given: EffectReadings, diagnosis: Diagnosis, theta: Array
) -> CorrectedEstimate | None:
    """The fit with the effects that the diagnosis decides for, as in `oed diagnose`."""
    by_name = {effect.name: effect for effect in bench.effects}
    effects = [
        with_constants(by_name[name], diagnosis.constants[name])
        for name in diagnosis.answers[0].effects
        if name in diagnosis.constants
    ]
    if diagnosis.verdict in ("none", "scatter") or not effects:
        return None
    return estimate_with_effects(given, effects, theta)


def _of_best(
    bench: world.Bench,
    problem: GapProblem,
    corrected: CorrectedEstimate,
    rng: np.random.Generator,
) -> Known:
    drawn = posterior.draw_approximation(
        corrected.measurement, corrected.series, bench.y, corrected.estimate, rng, DRAWS
    )
    count = corrected.parameters
    columns = corrected.columns
    shifts = _shifts(bench, problem, columns, drawn.theta[:, count:])
    return Known(drawn.theta[:, :count], shifts)


def _shifts(
    bench: world.Bench,
    problem: GapProblem,
    columns: ExpectedColumns | None,
    coefficients: Array,
) -> Array:
    """Displacements (m, rows, 3) of the tool by drawn effects (m, k)."""
    if columns is None:
        return np.zeros((len(coefficients), *bench.shift.shape))
    unit = tool_shifts(bench, problem, columns)
    return np.einsum("pik,dk->dpi", unit, coefficients)


def _absorbing(bench: world.Bench, mean: Array, known: Known) -> Array:
    """Parameters sent: the mean, shifted so that it takes up what effects are known to do."""
    tolerance = bench.measurement.tolerance[: len(mean)]
    error = known.shifts.mean(axis=0)
    return mean + absorbing_shift(slopes(bench, mean), error, tolerance)


# -- table -----------------------------------------------------------------------------


def table(records: Sequence[dict[str, Any]]) -> str:
    """A row for each machine, size and kind of compensation."""
    head = "| machine | one of | n | compensation | hold | ratio | error | largest | width |"
    lines = [head, "|---" * 9 + "|"]
    for machine in dict.fromkeys(r["machine"] for r in records):
        for size in sorted({r["size"] for r in records if r["machine"] == machine}):
            some = [r for r in records if (r["machine"], r["size"]) == (machine, size)]
            lines += [_row(machine, size, some, kind) for kind in KINDS]
    return "\n".join(lines)


def _row(
    machine: str, size: float, records: Sequence[dict[str, Any]], kind: str
) -> str:
    """Errors are over those of the best answer's compensation with the same corrections."""
    base = "best_effects" if kind.startswith("best_effects") else "best"
    error = np.array([r[kind]["rms_um"] for r in records])
    over = error / [r[base]["rms_um"] for r in records]
    predicted = np.array([r[kind]["predicted_um"] for r in records])
    width = predicted / [r[base]["predicted_um"] for r in records]
    hold = np.mean([r[kind]["coverage"] for r in records])
    ratio = np.quantile(error / predicted, [0.5, 0.9])
    mean = float(np.exp(np.mean(np.log(over))))
    level = "healthy" if not size else f"{size:.0f}"
    return (
        f"| {machine} | {level} | {len(records)} | {KINDS[kind]} | {hold:.2f} |"
        f" {ratio[0]:.1f}, {ratio[1]:.1f} | {mean:.2f} | {over.max():.2f} |"
        f" {np.median(width):.2f} |"
    )


if __name__ == "__main__":
    main()
