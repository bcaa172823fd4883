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
from benchmarks.real_machines.plans import MACHINES, UNKNOWNS, WORKSPACE
from oed.accuracy import error_maps
from oed.base.arrays import Array, Index
from oed.compensate.effects.planned_effects import PlannedEffects
from oed.design import candidates
from oed.design.blocks import information
from oed.design.criterion.variance import Variance
from oed.design.exchange import choose
from oed.estimation.effect_sizes import healthy_size
from oed.identifiability.information import prior_information
from pkm_studies.resolve.planned_effects import effects_of_planned, pose_error_slopes

PLANS = ("rigid", "typical", "full")


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
        total = self.prior + information(self.blocks[chosen])
        covariance = np.linalg.inv(total)
        variances = np.einsum("ri,ij,rj->r", self.factor, covariance, self.factor)
        return 1e6 * float(np.sqrt(variances.sum()))

    def plan(self, size: int, seed: int) -> Index:
        """The readings that serve this machine best."""
        criterion = Variance(np.linalg.qr(self.factor, mode="r"))
        rng = np.random.default_rng(seed)
        choice = choose(
            self.blocks, size, rng, criterion, prior=self.prior, certify=False
        )
        return np.sort(choice.indices)


def problems(bench: world.Bench, seed: int) -> dict[str, Problem]:
    """The session's candidates on machines with effects of each size."""
    measurement = bench.measurement
    where = bench.command[:: max(len(bench.command) // WORKSPACE, 1)]
    maps = error_maps(measurement.kinematics, where, "best_fit")
    place = SimpleNamespace(command=where, table=SimpleNamespace(reference="best_fit"))
    full = effects_of_planned(
        measurement,
        bench.series,
        bench.effects,
        SimpleNamespace(gravity=bench.gravity),
        place,
        np.random.default_rng(seed),
        UNKNOWNS,
    )
    assert full is not None
    # a machine without effects: nuisances that change nothing keep the columns alike
    sizes = {"rigid": 0.0, "typical": healthy_size(), "full": 1.0}
    moved = [k for k, name in enumerate(maps.names) if name in "xyz"]
    return {
        name: _problem(bench, full.of_size(size), maps.raw, moved)
        for name, size in sizes.items()
    }


def _problem(
    bench: world.Bench, effects: PlannedEffects, raw: Array, moved: list[int]
) -> Problem:
    measurement = bench.measurement
    pool = candidates.build(
        measurement,
        bench.series,
        measurement.nominal,
        "tolerance",
        nuisances=effects.readings,
    )
    prior = pool.prior_information.copy()
    prior[: pool.columns, : pool.columns] += prior_information(measurement)
    slopes = pose_error_slopes(pool, raw, effects)[:, moved]
    factor = slopes.reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes))
    return Problem(pool.blocks, prior, factor)


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
        worlds = problems(bench, seed)
        plans = [worlds[name].plan(options.readings, seed) for name in PLANS]
        for name, problem in worlds.items():
            plans_and_all = [*plans, np.arange(len(problem.blocks))]
            values = " | ".join(f"{problem.rms(plan):.4g}" for plan in plans_and_all)
            print(f"| {options.machine} | {seed} | {name} | {values} |", flush=True)


if __name__ == "__main__":
    main()
