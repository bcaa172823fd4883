"""Realised accuracy of plans for real machines beside plans for rigid ones.

    python -m benchmarks.real_machines.plans a3 --level typical --seeds 0 20 --out FILE.jsonl
    python -m benchmarks.real_machines.plans --table FILE.jsonl ...

Machines are drawn by an independent generator, with all of their effects. Of the
poses of its session each plan takes some, by the mean variance of the tool point over the
session's poses, as `[design]` with and without effects does. Both are fitted with effects
allowed. Judged is the true error of the tool point once the parameters are compensated.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real_machines import world
from benchmarks.real_machines.__main__ import judge
from benchmarks.real_machines.attainable import MACHINES, effects_of, problem
from oed.base import Array, Index
from oed.effects import expected_columns
from oed.estimation import Discrepancy, identify
from oed.gap.data import problem as problems

KINDS = ("rigid", "real")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machine", choices=MACHINES, nargs="?")
    parser.add_argument("--level", choices=world.LEVELS, default="healthy")
    parser.add_argument("--readings", type=int, default=48)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 20))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--table", type=Path, nargs="*")
    options = parser.parse_args()
    if options.table:
        print(table(options.table))
        return
    for seed in range(*options.seeds):
        record = one(options.machine, options.level, options.readings, seed)
        with options.out.open("a") as file:
            file.write(json.dumps(record) + "\n")


def one(machine: str, level: str, count: int, seed: int) -> dict[str, Any]:
    """Realised and predicted errors of both plans on one machine, um."""
    with tempfile.TemporaryDirectory() as folder:
        bench = world.draw(machine, 0, level, seed, Path(folder))
    record: dict[str, Any] = {
        "machine": machine,
        "level": level,
        "seed": seed,
        "readings": count,
    }
    chosen = {kind: _chosen(bench, count, seed, kind == "real") for kind in KINDS}
    for kind, indices in chosen.items():
        record[kind] = _realised(bench, indices, seed)
    common = set(chosen["rigid"]) & set(chosen["real"])
    record["common"] = len(common) / count
    return record


def _chosen(bench: world.Bench, count: int, seed: int, real: bool) -> Index:
    """Readings of the session that a plan takes, by their number."""
    rng = np.random.default_rng(seed)
    effects = effects_of(bench, rng).of_size(Discrepancy.HEALTHY) if real else None
    return problem(bench, effects).plan(count, rng)


def _realised(bench: world.Bench, indices: Index, seed: int) -> dict[str, float]:
    """Error once the parameters are compensated that chosen readings identify."""
    measurement, rng = bench.measurement, np.random.default_rng(seed)
    series, numbers = _taken(bench, indices)
    y, rows = bench.y[numbers], bench.covariates.iloc[indices].reset_index(drop=True)
    plain = identify(measurement, series, y)
    gap_problem = problems.assemble(
        measurement, series, rows, plain.theta, y, gravity=bench.gravity
    )
    columns = expected_columns(gap_problem, bench.effects)
    estimate = identify(
        measurement,
        gap_problem.series,
        y,
        discrepancy=None if columns is None else columns.discrepancy,
        rng=rng,
    )
    alone = plain.theta[None]
    theta, draws = plain.theta, alone
    if estimate.effects is not None:
        theta, draws = estimate.effects.theta.mean(axis=0), estimate.effects.theta
    return {
        "rms_um": judge(bench, theta, draws)["rms_um"],
        "rms_without_um": judge(bench, plain.theta, alone)["rms_um"],
    }


def _taken(bench: world.Bench, indices: Index) -> tuple[list[Any], Index]:
    """The chosen readings as series, and the numbers that they read."""
    series, numbers, reading, number = [], [], 0, 0
    for s in bench.series:
        channels = len(bench.measurement.setups[s.setup].sigma)
        rows = indices[(indices >= reading) & (indices < reading + len(s))] - reading
        if rows.size:
            series.append(s.take(rows))
            numbers.append(
                (number + channels * rows[:, None] + np.arange(channels)).ravel()
            )
        reading, number = reading + len(s), number + channels * len(s)
    return series, np.concatenate(numbers)


def table(files: Sequence[Path]) -> str:
    """Ratios of the realised errors, with the standard errors of their means."""
    lines = [
        "| machine | level | machines | rigid plan, um | real plan, um | ratio | standard error |"
        " 10 % | 90 % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for file in files:
        records = [json.loads(line) for line in file.read_text().splitlines()]
        errors = np.array([[r[kind]["rms_um"] for kind in KINDS] for r in records])
        lines.append(_line(records[0], errors))
    return "\n".join(lines)


def _line(record: dict[str, Any], errors: Array) -> str:
    logs = np.log(errors[:, 0] / errors[:, 1])
    error = float(logs.std(ddof=1) / np.sqrt(len(logs)))
    ratio = float(np.exp(logs.mean()))
    rigid, real = np.median(errors, axis=0)
    low, high = np.exp(np.quantile(logs, [0.1, 0.9]))
    return (
        f"| {record['machine']} | {record['level']} | {len(logs)} | {rigid:.3g} | {real:.3g} | {ratio:.2f} |"
        f" {ratio * error:.2f} | {low:.2f} | {high:.2f} |"
    )


if __name__ == "__main__":
    main()
