"""`oed next` against the fixed plan, over virtual machines.

    PYTHONPATH=. oed campaign --allow-code benchmarks/next_reading.campaign.toml
    python -m benchmarks.harness next_reading

Each machine is drawn from the tolerances and read with noise, one reading after another,
always the one that is advised, until the advice is to stop: once every component is as
accurate as the study's plan would be on this machine, as far as it is known
(`--wanted plan`). The second command prints how many readings that takes, and the
accuracy of both at the machine's true parameters, which the advice never knows.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import tables
from oed.base import Array
from oed.design import Candidates
from oed.measurement import draw_readings
from pkm_studies import shipped
from pkm_studies.sessions import Advice, Adviser
from pkm_studies.study import Study

MOST = 60  #: readings at which a machine counts as not reached
RATIO = "ratio_"  #: how the columns of ratios begin


@dataclasses.dataclass
class Session:
    """Readings of one machine (theta), in the order in which they are advised."""

    adviser: Adviser
    theta: Array
    rng: np.random.Generator
    taken: list[int] = dataclasses.field(default_factory=list)
    by_setup: dict[str, list[tuple[Advice, Array]]] = dataclasses.field(
        default_factory=dict
    )

    def run(self) -> None:
        """Read what is advised until the advice is to stop."""
        while len(self.taken) < MOST:
            advice = self._advice()
            if advice.is_reached:
                return
            self._read(advice)

    def _advice(self) -> Advice:
        measurement = self.adviser.base.resolved.measurement
        series, y = [], [np.zeros(0)]
        for pairs in self.by_setup.values():
            rows = np.array([advice.row for advice, _ in pairs])
            one = pairs[0][0].series.take(rows)
            labels = np.array([str(k + 1) for k in range(len(rows))])
            series.append(dataclasses.replace(one, run=labels))
            y += [reading for _, reading in pairs]
        return self.adviser.advise_after(measurement, series, np.concatenate(y))

    def _read(self, advice: Advice) -> None:
        one = advice.series.take(np.array([advice.row]))
        measurement = self.adviser.base.resolved.measurement
        reading = draw_readings(measurement, [one], self.theta, self.rng)
        self.by_setup.setdefault(advice.series.setup, []).append((advice, reading))
        self.taken.append(advice.candidate)


def session(setting: Mapping[str, Any], seed: int) -> dict[str, float]:
    """The session on machine `seed` of a study.

    Readings of the fixed plan and until the advice was to stop; rms of each component
    over that of the fixed plan, at the machine's true parameters.
    """
    adviser = _adviser(setting["study"])
    measurement = adviser.base.resolved.measurement
    rng = np.random.default_rng([adviser.base.study.seed, seed])
    draw = rng.standard_normal(len(measurement.nominal))
    one = Session(adviser, measurement.nominal + measurement.tolerance * draw, rng)
    one.run()
    chosen = adviser.base.resolved.candidates
    pool = Candidates.build(measurement, chosen, one.theta, "tolerance")
    fixed, advised = (
        adviser.accuracy(measurement, pool, indices)
        for indices in (adviser.plan, one.taken)
    )
    ratios = zip(adviser.maps.names, advised / fixed, strict=True)
    return {
        "fixed": len(adviser.plan),
        "readings": len(one.taken),
        **{f"{RATIO}{name}": float(ratio) for name, ratio in ratios},
    }


@functools.cache
def _adviser(study: str) -> Adviser:
    return Adviser(Study.load(shipped.study_path(Path(study))), "plan")


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table: readings, and the accuracy of each component."""
    sessions = pd.DataFrame(rows)
    fixed = int(sessions["fixed"].iloc[0])
    needed = sessions["readings"].to_numpy(dtype=float)
    lines = [
        f"`{sessions['study'].iloc[0]}`, {len(sessions)} machines; the fixed plan has"
        f" {fixed} readings. `oed next` stops after {needed.mean():.2f} ±"
        f" {_half(needed):.2f} on average.",
        "",
        tables.head("rms over that of the fixed plan", "mean", "largest"),
    ]
    columns = [c for c in sessions.columns if c.startswith(RATIO)]
    ratios = sessions[columns].to_numpy()
    figures = dict(zip(columns, ratios.T, strict=True))
    figures["worst component"] = ratios.max(axis=1)
    figures["geometric mean"] = np.exp(np.log(ratios).mean(axis=1))
    for name, values in figures.items():
        mean = f"{values.mean():.3f} ± {_half(values):.3f}"
        lines.append(tables.row(name.removeprefix(RATIO), mean, f"{values.max():.3f}"))
    return "\n".join(lines)


def _half(values: Array) -> float:
    """Half the 95 % interval of a mean."""
    if len(values) < 2:
        return float("inf")
    return float(1.96 * values.std(ddof=1) / np.sqrt(len(values)))
