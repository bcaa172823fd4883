"""Chooses the runs of [gap.design], which separate the wanted effects best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import dataset, gap
from oed.base import Array
from oed.design import Rules
from oed.gap import GapProblem, RunsWanted
from oed.measurement import Measurement, Series
from oed.result import ChosenRun, ChosenRuns
from pkm_studies.resolve import GapDesignRequest, GapRequest, comments_of

if TYPE_CHECKING:
    import pandas as pd


def choose_runs(
    measurement: Measurement,
    design: GapDesignRequest,
    rules: Rules,
    planned: GapProblem,
    request: GapRequest,
    rng: np.random.Generator,
) -> tuple[ChosenRuns, str]:
    """The runs that separate the wanted effects best from each other and from rivals.

    planned    readings planned without [gap.design]

    Retained runs are among them. The second result is a readings file to fill in.
    Raises InputError where no run shows the effects or the rules allow no plan.
    """
    wanted = RunsWanted(
        runs=design.runs,
        retained=design.retained,
        wanted=design.wanted,
        rivals=design.rivals,
        share=design.table.share,
        rounds=design.table.starts,
    )
    try:
        choice, series, covariates = gap.choose_runs(
            measurement, wanted, rules, planned, rng
        )
    except ValueError as error:
        remedy = "give conditions that show it, or other effects or rules"
        raise design.location.error(str(error), remedy) from error
    selected = [design.runs[k] for k in choice.runs]
    timed = covariates
    if "time" not in covariates:
        timed = covariates.assign(time=_times(covariates, design, rules))
    taken = gap.assemble(measurement, series, timed, gravity=request.gravity)
    chosen = ChosenRuns(
        candidates=len(design.runs) - len(design.retained),
        retained=len(design.retained),
        runs=[
            ChosenRun(run.setup, run.name, dict(run.condition), run.seconds)
            for run in selected
        ],
        separation=choice.separation,
        bound=choice.bound,
        before=choice.before,
        efficiency=choice.efficiency,
        proven=choice.proven,
        share=design.table.share,
        volume=choice.volume,
        seconds=choice.seconds,
        separations=choice.pairs,
        table=gap.detect(taken, taken.stated_law, request.effects, rng),
    )
    return chosen, poses_csv(measurement, series, covariates)


def _times(covariates: pd.DataFrame, design: GapDesignRequest, rules: Rules) -> Array:
    """Time of each reading (n,), s, where the runs follow one another."""
    mounting = dict.fromkeys((run.setup for run in design.runs), 0.0)
    if rules.setups is not None and rules.setups.seconds is not None:
        mounting = dict(zip(mounting, rules.setups.seconds.tolist(), strict=True))
    seconds = {(run.setup, run.name): run.seconds for run in design.runs}
    clock, mounted, times = 0.0, "", []
    for (setup, name), rows in covariates.groupby(["setup", "run"], sort=False):
        clock += mounting[setup] if setup != mounted else 0.0
        mounted = setup
        duration = seconds[setup, name]
        times.append(clock + duration * np.arange(1, len(rows) + 1) / len(rows))
        clock += duration
    return np.concatenate(times)


def poses_csv(
    measurement: Measurement, series: Sequence[Series], covariates: pd.DataFrame
) -> str:
    """Runs as a readings file; readings and times are to be filled in."""
    columns = covariates.drop(columns=["setup", "run", "order"]).assign(time=np.nan)
    empty = np.full(len(measurement.setup_of_readings(series)), np.nan)
    readings = dataset.from_series(series, empty, measurement, columns)
    return dataset.to_csv(readings, comments_of(measurement))
