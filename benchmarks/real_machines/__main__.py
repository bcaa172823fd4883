"""Accuracy that is predicted and reached on machines with small effects.

    python -m benchmarks.real_machines planar healthy 10 --seeds 200 210 --out FILE.jsonl

Machines are drawn by an independent generator (`benchmarks.second`). Judged is the error
of the tool point at the session's poses, free of its best rigid motion: by the parameters
alone, and with the effects corrected as well.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real_machines import world
from oed.accuracy import ErrorMaps
from oed.base import Array
from oed.effects import ExpectedColumns, absorbing_shift, expected_columns
from oed.estimation import Discrepancy, Estimate, identify
from oed.gap.data import problem as problems

#: draws of an estimate that are judged
DRAWS = 200
INTERVAL = (0.025, 0.975)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machine", choices=("a3", "planar", "delta", "hexapod"))
    parser.add_argument("level", choices=("rigid", "healthy"))
    parser.add_argument("size", type=float)
    parser.add_argument("--seeds", type=int, nargs=2, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    for seed in range(*options.seeds):
        record = one(options.machine, options.level, options.size, seed)
        with options.out.open("a") as file:
            file.write(json.dumps(record) + "\n")


def one(machine: str, level: str, size: float, seed: int) -> dict[str, Any]:
    """One machine: today's fit, and those with effects."""
    with tempfile.TemporaryDirectory() as folder:
        bench = world.draw(machine, size, level, seed, Path(folder))
    record: dict[str, Any] = dict(
        machine=machine, level=level, size=size, seed=seed, **bench.case
    )
    rng = np.random.default_rng(seed)
    started = time.process_time()
    law = identify(bench.measurement, bench.series, bench.y, estimate_noise=True)
    record["seconds_law"] = time.process_time() - started
    record["law"] = judge(bench, law.theta, _normal_draws(law, rng))
    started = time.process_time()
    plain = identify(bench.measurement, bench.series, bench.y)
    problem = problems.assemble(
        bench.measurement,
        bench.series,
        bench.covariates,
        plain.theta,
        bench.y,
        gravity=bench.gravity,
    )
    columns = expected_columns(problem, bench.effects)
    record["seconds_columns"] = time.process_time() - started
    estimate = identify(
        bench.measurement,
        problem.series,
        bench.y,
        estimate_noise=True,
        discrepancy=columns.of_sizes(
            np.concatenate([Discrepancy.SMALL, Discrepancy.LARGE])
        ).discrepancy,
        rng=rng,
    )
    record["seconds"] = time.process_time() - started
    shifts = tool_shifts(bench, problem, columns)
    sampled = estimate.effects
    record["log_evidence"] = sampled.log_evidence
    record["size"] = float(np.sqrt((sampled.size**2).mean()))
    record["columns"], record["readings"] = len(sampled.coefficients.T), len(bench.y)
    null = estimate.coordinates.null_basis
    lost = rng.standard_normal((len(sampled.theta), null.shape[1])) @ null.T
    drawn = np.einsum("pik,dk->dpi", shifts, sampled.coefficients)
    mean = sampled.theta.mean(axis=0)
    record["geometry"] = judge(bench, mean, sampled.theta + lost, drawn)
    record["corrected"] = judge(
        bench, mean, sampled.theta + lost, drawn, drawn.mean(axis=0)
    )
    known = drawn.mean(axis=0)
    sent = mean + absorbing_shift(
        slopes(bench, mean), known, bench.measurement.tolerance[: len(mean)]
    )
    record["sent"] = judge(bench, sent, sampled.theta + lost, drawn)
    return record


def slopes(bench: world.Bench, theta: Array) -> ErrorMaps:
    """Displacements (rows, 3, n) of the tool per parameter at the session's rows."""
    machine = bench.measurement.machine
    count = len(machine.parameters)
    steps = 1e-3 * bench.measurement.tolerance[:count]
    moved = world.displacement(
        bench, np.vstack([theta[None, :count], theta[:count] + np.diag(steps)])
    )
    change = np.zeros((*moved.shape[1:], len(theta)))
    free = np.flatnonzero(steps)
    for k in free:
        change[:, :, k] = (moved[1 + k] - moved[0]) / steps[k]
    return ErrorMaps(bench.command, ("x", "y", "z"), change, np.zeros_like(change))


def _normal_draws(estimate: Estimate, rng: np.random.Generator) -> Array:
    values, vectors = np.linalg.eigh(estimate.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return estimate.theta + rng.standard_normal((DRAWS, len(root))) @ root.T


def tool_shifts(
    bench: world.Bench, problem: problems.GapProblem, columns: ExpectedColumns
) -> Array:
    """Displacements (n, 3, k) of the tool at the session's rows per unit of each column."""
    machine = bench.measurement.machine
    count = len(machine.parameters)
    row_of = {
        (setup, round(float(t), 6)): i
        for i, (setup, t) in enumerate(zip(bench.setup_names, bench.times, strict=True))
    }
    at = {}
    for number, form in enumerate(columns.forms):
        for name in form.names:
            at[number, name] = len(at)
    table = np.zeros((len(bench.command), 3, len(at)))
    for series, state in zip(problem.series, problem.states, strict=True):
        kinematics = bench.measurement.kinematics
        tool = np.array(bench.measurement.setups[series.setup].tool)
        slopes = kinematics.slopes.over_parameters(
            state.pose, state.joints, problem.theta[:count]
        )
        frames = kinematics.frames(state.pose, tool)[2]
        by_parameter = np.einsum("mij,mjk->mik", frames[:, :3], slopes)
        rows = np.array(
            [row_of.get((series.setup, round(float(t), 6)), -1) for t in state.time]
        )
        seen = rows >= 0
        for number, form in enumerate(columns.forms):
            for column in form.effect.columns(state, **form.constants):
                if (number, column.name) not in at:
                    continue
                moved = np.zeros((len(state), 3))
                for joint, change in column.joints.items():
                    moved += state.twist[:, :3, joint] * change[:, None]
                for name, change in column.parameters.items():
                    if name in {p.name for p in machine.parameters}:
                        moved += (
                            by_parameter[:, :, machine.index(name)] * change[:, None]
                        )
                table[rows[seen], :, at[number, column.name]] = (
                    moved[seen] * column.scale
                )
    return table @ columns.mixing


def judge(
    bench: world.Bench,
    theta: Array,
    draws: Array,
    effects: Array | None = None,
    corrected: Array | float = 0.0,
) -> dict[str, float]:
    """Error of the tool point that is left, beside its intervals.

    draws    (m, n) of the parameters;  effects (m, rows, 3) displacements by effects
    corrected  (rows, 3) displacement that is corrected beside the parameters
    """
    machine = bench.measurement.machine
    axes = np.array([1, 2]) if machine.name.startswith("planar") else np.arange(3)
    count = len(machine.parameters)
    kinematics = bench.measurement.kinematics
    points = np.zeros_like(bench.shift)
    for tool in np.unique(bench.tool, axis=0):
        rows = np.flatnonzero((bench.tool == tool).all(axis=1))
        pose, _ = kinematics.inverse(bench.command[rows], machine.nominal, tool)
        points[rows] = kinematics.frames(pose, tool)[1]
    moved = world.displacement(
        bench, np.vstack([theta[None, :count], draws[:, :count]])
    )
    stated = moved[0] + corrected
    machines = moved[1:] if effects is None else moved[1:] + effects
    error = world.free_of_frame(points, (bench.shift - stated)[None], axes)[0]
    drawn = world.free_of_frame(points, machines - stated, axes)
    low, high = np.quantile(drawn, INTERVAL, axis=0)
    rms = np.sqrt((drawn**2).mean(axis=1))
    return {
        "coverage": float(((error > low) & (error < high)).mean()),
        "rms_um": 1e6 * float(np.sqrt((error**2).mean())),
        "predicted_um": 1e6 * float(np.median(rms)),
    }


if __name__ == "__main__":
    main()
