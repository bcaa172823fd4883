"""`oed next` against the fixed plan, over virtual machines.

    python -m benchmarks.next_reading [STUDY] [MACHINES]

Each machine is drawn from the tolerances and read with noise, one reading after another,
always the one that is advised, until the advice is to stop. What is asked for is what the
fixed plan reaches on this machine, in every component. Printed: how many readings that
takes, and the accuracy at the machine's true parameters over that of the fixed plan.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

from oed import simulation
from oed.arrays import Array
from oed.design import candidates, next_reading
from oed.measurement import Series
from pkm_studies import shipped
from pkm_studies.next_reading import Adviser
from pkm_studies.stages.design.select import ChosenDesign, select_design
from pkm_studies.study import load

#: readings at which a machine counts as not reached
MOST = 60


def run(study: str, machines: int) -> tuple[int, Array, Array]:
    """Readings of the fixed plan; readings (m,) and worst ratio (m,) of each machine."""
    adviser = Adviser(load(shipped.study_path(Path(study))))
    resolved = adviser.base.resolved
    rng = np.random.default_rng(resolved.study.seed)
    chosen = select_design(resolved, rng)
    assert chosen is not None
    nominal = resolved.measurement.nominal
    needed, ratios = [], []
    for _ in range(machines):
        tolerance = resolved.measurement.tolerance
        theta = nominal + tolerance * rng.standard_normal(len(nominal))
        fixed = _accuracy(adviser, theta, chosen.choice.indices)
        adviser.limits = fixed
        taken = _session(adviser, theta, rng)
        ratios.append(float((_accuracy(adviser, theta, taken) / fixed).max()))
        needed.append(len(taken))
        print(
            f"{len(needed)}: {needed[-1]} readings, ratio {ratios[-1]:.3f}", flush=True
        )
    return _size(chosen), np.array(needed), np.array(ratios)


def _size(chosen: ChosenDesign) -> int:
    return len(chosen.choice.indices)


def _accuracy(adviser: Adviser, theta: Array, taken: list[int] | Array) -> Array:
    """Rms (K,) after candidates, linearised at a machine's parameters (n,)."""
    resolved = adviser.base.resolved
    measurement = resolved.measurement
    pool = candidates.build(measurement, resolved.candidates, theta, "tolerance")
    belief = adviser.prior(measurement, pool)
    return np.sqrt(next_reading.after_all(belief, pool.blocks, list(taken)).variances)


def _session(adviser: Adviser, theta: Array, rng: np.random.Generator) -> list[int]:
    """Candidates in the order in which they are read, until the advice is to stop."""
    measurement = adviser.base.resolved.measurement
    series: list[Series] = []
    y = np.zeros(0)
    taken: list[int] = []
    while len(taken) < MOST:
        advice = adviser.advise_after(measurement, series, y)
        if advice.is_reached:
            break
        one = advice.series.take(np.array([advice.row]))
        reading = simulation.draw_readings(measurement, [one], theta, rng)
        series.append(dataclasses.replace(one, run=np.array([str(len(taken) + 1)])))
        y = np.concatenate([y, reading])
        taken.append(advice.candidate)
    return taken


def main() -> None:
    """Print the readings of the fixed plan and of the sessions, with their accuracy."""
    study = sys.argv[1] if len(sys.argv) > 1 else "a3_ball_bar"
    machines = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    fixed, needed, ratios = run(study, machines)
    few, many = np.quantile(needed, [0.05, 0.95])
    print(f"{study}, {machines} machines; the fixed plan has {fixed} readings.")
    print(f"oed next stops after {few:.0f} to {many:.0f} (5 % to 95 %), {needed.mean():.1f}"
          f" on average, {100 * needed.mean() / fixed:.0f} % of the plan's.")  # fmt: skip
    low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
    print(f"Worst component over that of the fixed plan: {middle:.2f}"
          f" ({low:.2f} to {high:.2f}).")  # fmt: skip


if __name__ == "__main__":
    main()
