"""What plans for real machines can gain over plans for rigid ones, by the criterion.

    PYTHONPATH=. oed campaign --allow-code benchmarks/attainable.campaign.toml --seeds 4
    python -m benchmarks.harness attainable

From the poses of one session each plan takes some: for a rigid machine, for effects of the
typical size of a healthy machine, and for effects of the full size that the catalogue
expects. Each plan is valued on machines with effects of each of these sizes, by the mean
variance of the tool point over the session's poses. All readings of the session together
are a bound for every plan. Machines are drawn by an independent generator.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.harness import tables
from benchmarks.real_machines import world
from oed.accuracy import ErrorMaps
from oed.base import Array, Index
from oed.design import CRITERIA, Candidates, choose
from oed.effects import PlannedEffects
from oed.estimation import Discrepancy
from oed.identifiability import prior_information
from pkm_studies.base import Location
from pkm_studies.resolve import GapRequest
from pkm_studies.tables import ConditionsTable

#: sizes of effects that a plan is made for, and that a machine has; all readings
SIZES, ALL = ("rigid", "typical", "full"), "all readings"
UNKNOWNS = 60  #: combinations of effects that a plan profiles out
WORKSPACE = 60  #: poses of the session at which accuracy counts while planning


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
    lines = [tables.head("machine", "n", "effects", *columns)]
    for machine in dict.fromkeys(row["machine"] for row in rows):
        some = [row for row in rows if row["machine"] == machine]
        for size in SIZES:
            values = np.array([[row[size][plan] for plan in columns] for row in some])
            best = values[:, SIZES.index(size)]
            loss = 100.0 * (values / best[:, None] - 1.0).max(axis=0)
            pairs = zip(values.mean(axis=0), loss, strict=True)
            cells = [f"{value:.4g} ({most:.1f} %)" for value, most in pairs]
            lines.append(tables.row(machine, len(some), size, *cells))
    return "\n".join(lines)


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Candidates of a session on a machine with effects of one size."""

    blocks: Array  #: (C, k, n) rows over parameters and effects
    prior: Array  #: (n, n) information before any reading
    factor: Array  #: (r, n) errors of the tool point over the workspace, m

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
