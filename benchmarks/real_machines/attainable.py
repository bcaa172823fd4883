"""What any plan could gain on machines with effects, by its own criterion.

    python -m benchmarks.real_machines.attainable planar --readings 40 --seeds 0 4

From the poses of one session each plan takes some: for a rigid machine, for effects of the
typical size of a healthy machine, and for effects of the full size that the catalogue
expects. Each plan is valued on machines with effects of each of these sizes, by the mean
variance of the tool point over the session's poses. All readings of the session together
are a bound for every plan.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from benchmarks.real_machines import world
from oed.accuracy import error_maps
from oed.base import Array, Index
from oed.design import CRITERIA, Candidates, choose
from oed.effects import PlannedEffects
from oed.estimation import Discrepancy
from oed.identifiability import prior_information
from pkm_studies.resolve import effects_of_planned, pose_error_slopes

MACHINES = ("a3", "planar", "delta", "hexapod")
PLANS = ("rigid", "typical", "full")
#: combinations of effects that a plan profiles out
MAX_EFFECT_UNKNOWNS = 60
#: poses of the session at which accuracy counts while planning
WORKSPACE = 60


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
        criterion = CRITERIA.over("I", self.factor.shape[1], self.factor[None])
        choice = choose(
            self.blocks, size, rng, criterion, prior=self.prior, certify=False
        )
        return np.sort(choice.indices)


def effects_of(bench: world.Bench, rng: np.random.Generator) -> PlannedEffects:
    """What all effects of a bench's machine do to its session, at expected sizes."""
    location = SimpleNamespace(
        command=_workspace(bench), table=SimpleNamespace(reference="best_fit")
    )
    request = SimpleNamespace(gravity=bench.gravity)
    effects = effects_of_planned(
        bench.measurement,
        bench.series,
        bench.effects,
        request,
        location,
        rng,
        MAX_EFFECT_UNKNOWNS,
    )
    assert effects is not None  # every machine of the generator has some
    return effects


def problem(bench: world.Bench, effects: PlannedEffects | None) -> Problem:
    """The session's candidates on a machine with these effects, or without any."""
    measurement = bench.measurement
    maps = error_maps(measurement.kinematics, _workspace(bench), "best_fit")
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
    slopes = pose_error_slopes(pool, maps.raw, SimpleNamespace(tool=tool))
    moved = [k for k, name in enumerate(maps.names) if name in "xyz"]
    factor = slopes[:, moved].reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes))
    return Problem(pool.blocks, prior, factor)


def _workspace(bench: world.Bench) -> Array:
    """Some of the session's commands, at which accuracy counts."""
    return bench.command[:: max(len(bench.command) // WORKSPACE, 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machine", choices=MACHINES)
    parser.add_argument("--readings", type=int, default=48)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 4))
    options = parser.parse_args()
    print("| machine | seed | effects | " + " | ".join(PLANS) + " | all readings |")
    print("|---|---|---|---|---|---|---|")
    for seed in range(*options.seeds):
        with tempfile.TemporaryDirectory() as folder:
            bench = world.draw(options.machine, 0, "healthy", seed, Path(folder))
        full = effects_of(bench, np.random.default_rng(seed))
        sizes = (None, full.of_size(Discrepancy.HEALTHY), full)
        worlds = [problem(bench, effects) for effects in sizes]
        plans = [
            one.plan(options.readings, np.random.default_rng(seed)) for one in worlds
        ]
        plans.append(np.arange(len(worlds[0].blocks)))
        for name, one in zip(PLANS, worlds, strict=True):
            values = " | ".join(f"{one.rms(plan):.4g}" for plan in plans)
            print(f"| {options.machine} | {seed} | {name} | {values} |", flush=True)


if __name__ == "__main__":
    main()
