"""Candidate runs, a circle or a line under one condition, laid out as readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from oed.base.arrays import Array, Index
from oed.gap.data import state
from oed.gap.data.problem import GapProblem, assemble
from oed.measurement.measurement import Measurement, Series

#: covariates that a condition may state
CONDITIONS = ("time", "direction", "feed", "payload")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """A run that could be taken: poses in order, under one condition.

    name         unique in its set-up
    setup        name of the set-up
    command      (n, n_dof) poses, SI, in the order of direction +1; with direction -1
                 they are taken in reverse
    condition    {covariate: value}, SI: `direction`, `feed`, `payload`, and `time` at
                 which it starts
    seconds      that it takes
    """

    name: str
    setup: str
    command: Array
    condition: Mapping[str, float] = dataclasses.field(default_factory=dict)
    seconds: float = 0.0

    def __post_init__(self) -> None:
        unknown = sorted(set(self.condition) - set(CONDITIONS))
        if unknown:
            raise ValueError(
                f"run {self.name}: no condition {unknown}; there are {list(CONDITIONS)}"
            )
        if self.condition.get("direction", 1.0) not in (-1.0, 1.0):
            raise ValueError(
                f"run {self.name}: direction is +1 or -1, not"
                f" {self.condition['direction']:g}"
            )
        if len(self.command) < 2:
            raise ValueError(
                f"run {self.name}: a run has at least 2 poses, not {len(self.command)}"
            )


def lay_out(
    measurement: Measurement, runs: Sequence[Run]
) -> tuple[tuple[Series, ...], pd.DataFrame]:
    """Series of all runs, one a set-up, and one row of covariates a reading.

    Raises ValueError for runs of one name in a set-up, AssemblyError for poses out of
    reach.
    """
    keys = [(r.setup, r.name) for r in runs]
    if len(set(keys)) < len(keys):
        twice = sorted({key[1] for key in keys if keys.count(key) > 1})
        raise ValueError(
            f"runs need names of their own in a set-up: {twice} are used twice"
        )
    series, rows = [], []
    for setup in dict.fromkeys(r.setup for r in runs):
        of_setup = [r for r in runs if r.setup == setup]
        labels = [r.name for r in of_setup for _ in range(len(r.command))]
        command = np.vstack([_in_order(r) for r in of_setup])
        series.append(measurement.series(setup, command, labels))
        instrument = measurement.setups[setup].instrument
        skipped = 1 if instrument.reference == "run" else 0
        rows += [_covariates(r, skipped) for r in of_setup]
    return tuple(series), pd.concat(rows, ignore_index=True)


def _in_order(run: Run) -> Array:
    """Poses of a run in the order in which they are taken."""
    direction = int(run.condition.get("direction", 1.0))
    return run.command[::direction]


def _covariates(run: Run, skipped: int) -> pd.DataFrame:
    """One row a reading.

    `skipped` poses at the start are a reference and not a reading.
    """
    order = np.arange(skipped, len(run.command))
    stated = {c: v for c, v in run.condition.items() if c != "time"}
    table = pd.DataFrame(
        {"setup": run.setup, "run": run.name, "order": order, **stated}
    )
    if "time" in run.condition:
        since_start = order * run.seconds / len(run.command)
        table["time"] = run.condition["time"] + since_start
    return table


def prepare(
    measurement: Measurement,
    runs: Sequence[Run],
    *,
    gravity: tuple[float, float, float] = state.DOWN,
) -> tuple[GapProblem, tuple[Index, ...]]:
    """The problem of all candidate runs as if taken, and each run's rows in it."""
    series, covariates = lay_out(measurement, runs)
    problem = assemble(measurement, series, covariates, gravity=gravity)
    at = problem.rows.groupby(["setup", "run"], sort=False).indices
    return problem, tuple(np.asarray(at[r.setup, r.name], dtype=np.intp) for r in runs)
