"""Plans for real machines beside plans for rigid ones: by the criterion, and as realised.

    PYTHONPATH=. oed campaign --allow-code benchmarks/attainable.campaign.toml --seeds 4
    python -m benchmarks.harness attainable
    PYTHONPATH=. oed campaign --allow-code benchmarks/real_plans.campaign.toml --seeds 8
    python -m benchmarks.harness real_plans

From the poses of one session each plan takes some. `attainable`: for a rigid machine, for
effects of the typical size of a healthy machine, and for effects of the full size that the
catalogue expects; each plan is valued on machines with effects of each of these sizes, by
the mean variance of the tool point over the session's poses. All readings of the session
together are a bound for every plan.

`real_plans`: as `[design]` with and without effects does. Machines are drawn by an
independent generator, with all of their effects, and both plans are fitted with effects
allowed. Judged is the true error of the tool point once the parameters are compensated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.real_machines import world
from benchmarks.real_machines.cases import judge
from oed.accuracy import ErrorMaps
from oed.base import Array, Index
from oed.design import CRITERIA, Candidates, choose
from oed.effects import ExpectedColumns, PlannedEffects
from oed.estimation import Discrepancy, identify
from oed.gap import assemble
from oed.identifiability import prior_information
from pkm_studies.base import Location
from pkm_studies.resolve import GapRequest
from pkm_studies.tables import ConditionsTable

#: sizes of effects that a plan is made for, and that a machine has; all readings
SIZES, ALL = ("rigid", "typical", "full"), "all readings"
#: combinations of effects that a plan profiles out
UNKNOWNS = 60
#: poses of the session at which accuracy counts while planning
WORKSPACE = 60
KINDS = ("rigid", "real")


def attainable(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Rms error, um, by the sizes of the machine's effects and of those of the plan."""
    bench = world.draw(setting["machine"], 0, "healthy", seed)
    full = effects_of(bench, np.random.default_rng(seed))
    effects = (None, full.of_size(Discrepancy.HEALTHY), full)
    machines = {n: problem(bench, e) for n, e in zip(SIZES, effects, strict=True)}
    plans = {
        name: one.plan(setting["readings"], np.random.default_rng(seed))
        for name, one in machines.items()
    }
    plans[ALL] = np.arange(len(machines["rigid"].blocks))
    return {
        name: {plan: one.rms(indices) for plan, indices in plans.items()}
        for name, one in machines.items()
    }


def attainable_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Mean errors by machine; in brackets the largest loss against the best plan."""
    columns = (*SIZES, ALL)
    lines = [f"| machine | n | effects | {' | '.join(columns)} |", "|---" * 7 + "|"]
    for machine in dict.fromkeys(row["machine"] for row in rows):
        some = [row for row in rows if row["machine"] == machine]
        for size in SIZES:
            values = np.array([[row[size][plan] for plan in columns] for row in some])
            best = values[:, SIZES.index(size)]
            loss = 100.0 * (values / best[:, None] - 1.0).max(axis=0)
            cells = [
                f"{v:.4g} ({x:.1f} %)"
                for v, x in zip(values.mean(0), loss, strict=True)
            ]
            cells[-1] = f"{values[:, -1].mean():.4g}"
            lines.append(f"| {machine} | {len(some)} | {size} | {' | '.join(cells)} |")
    return "\n".join(lines)


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Candidates of a session on a machine with effects of one size.

    blocks  (C, k, n) rows over parameters and effects
    prior   (n, n) information before any reading
    factor  (r, n) errors of the tool point over the workspace, m
    """

    blocks: Array
    prior: Array
    factor: Array

    def rms(self, chosen: Index) -> float:
        """Root mean square error of the tool point with chosen readings, um."""
        rows = self.blocks[chosen].reshape(-1, self.blocks.shape[2])
        total = self.prior + rows.T @ rows
        covariance = np.linalg.inv(total)
        variances = np.einsum("ri,ij,rj->r", self.factor, covariance, self.factor)
        return 1e6 * float(np.sqrt(variances.sum()))

    def plan(self, size: int, rng: np.random.Generator) -> Index:
        """The readings that serve this machine best."""
        criterion = CRITERIA.build("I", self.factor.shape[1], self.factor[None])
        choice = choose(
            self.blocks, size, rng, criterion, prior=self.prior, certify=False
        )
        return np.sort(choice.indices)


def effects_of(bench: world.Bench, rng: np.random.Generator) -> PlannedEffects:
    """What all effects of a bench's machine do to its session, at expected sizes."""
    place = SimpleNamespace(
        command=_workspace(bench), table=SimpleNamespace(reference="best_fit")
    )
    request = GapRequest(tuple(bench.effects), bench.gravity, (), ConditionsTable())
    effects = request.planned_effects(
        bench.measurement, bench.series, "catalogue", Location(""), place, rng, UNKNOWNS
    )
    assert effects is not None  # every machine of the generator has some
    return effects


def problem(bench: world.Bench, effects: PlannedEffects | None) -> Problem:
    """The session's candidates on a machine with these effects, or without any."""
    measurement = bench.measurement
    maps = ErrorMaps.of(measurement.kinematics, _workspace(bench), "best_fit")
    pool = Candidates.build(
        measurement,
        bench.series,
        measurement.nominal,
        "tolerance",
        nuisances=None if effects is None else effects.readings,
    )
    prior = pool.prior_information.copy()
    prior[: pool.columns, : pool.columns] += prior_information(measurement)
    tool = np.zeros((*maps.raw.shape[:2], 0)) if effects is None else effects.tool
    slopes = pool.pose_error_slopes(maps.raw, tool)
    moved = [k for k, name in enumerate(maps.names) if name in "xyz"]
    factor = slopes[:, moved].reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes))
    return Problem(pool.blocks, prior, factor)


def _workspace(bench: world.Bench) -> Array:
    """Some of the session's commands, at which accuracy counts."""
    return bench.command[:: max(len(bench.command) // WORKSPACE, 1)]


# -- as realised -----------------------------------------------------------------------


def realised(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Realised errors of both plans on one machine, um."""
    bench = world.draw(setting["machine"], 0, setting["level"], seed)
    count = setting["readings"]
    chosen = {kind: _chosen(bench, count, seed, kind == "real") for kind in KINDS}
    record: dict[str, Any] = {
        kind: _realised(bench, indices, seed) for kind, indices in chosen.items()
    }
    common = set(chosen["rigid"]) & set(chosen["real"])
    return record | {"common": len(common) / count}


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
    gap_problem = assemble(
        measurement, series, rows, plain.theta, y, gravity=bench.gravity
    )
    columns = ExpectedColumns.of(gap_problem, bench.effects)
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


def realised_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Ratios of the realised errors, with the standard errors of their means."""
    lines = [
        "| machine | level | machines | rigid plan, um | real plan, um | ratio | standard error |"
        " 10 % | 90 % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["machine"], row["level"]), []).append(row)
    for (machine, level), some in groups.items():
        errors = np.array([[r[kind]["rms_um"] for kind in KINDS] for r in some])
        lines.append(f"| {machine} | {level} | {_line(errors)} |")
    return "\n".join(lines)


def _line(errors: Array) -> str:
    logs = np.log(errors[:, 0] / errors[:, 1])
    error = float(logs.std(ddof=1) / np.sqrt(len(logs)))
    ratio = float(np.exp(logs.mean()))
    rigid, real = np.median(errors, axis=0)
    low, high = np.exp(np.quantile(logs, [0.1, 0.9]))
    return (
        f"{len(logs)} | {rigid:.3g} | {real:.3g} | {ratio:.2f} |"
        f" {ratio * error:.2f} | {low:.2f} | {high:.2f}"
    )
