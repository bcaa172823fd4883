"""Chooses the runs of [gap.design], which separate the wanted effects best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from oed import dataset
from oed.base import Array, Index
from oed.design import Rules
from oed.gap.before import choose, detect, runs
from oed.gap.before.runs import pool_runs
from oed.gap.before.separation import Separation
from oed.gap.data import problem
from oed.gap.data.problem import GapProblem
from oed.measurement import Measurement, Series
from oed.result import ChosenRun, ChosenRuns, SeparationRecord
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
    gravity = request.gravity
    candidates, rows = runs.prepare(measurement, design.runs, gravity=gravity)
    try:
        choice = choose.choose(
            _pool(candidates, rows, design),
            rules,
            rng,
            share=design.table.share,
            fixed=np.array(design.retained, dtype=np.intp),
            rounds=design.table.starts,
        )
    except ValueError as error:
        remedy = "give conditions that show it, or other effects or rules"
        raise design.location.error(str(error), remedy) from error
    selected = [design.runs[k] for k in choice.runs]
    series, covariates = runs.lay_out(measurement, selected)
    timed = covariates
    if "time" not in covariates:
        timed = covariates.assign(time=_times(covariates, design, rules))
    taken = problem.assemble(measurement, series, timed, gravity=gravity)
    separations = _add_earlier(choice.pairs, planned, design)
    chosen = ChosenRuns(
        candidates=len(design.runs) - len(design.retained),
        retained=len(design.retained),
        runs=[
            ChosenRun(run.setup, run.name, dict(run.condition), run.seconds)
            for run in selected
        ],
        separation=choice.separation,
        bound=choice.bound,
        before=_least_before(separations),
        efficiency=choice.efficiency,
        proven=choice.proven,
        share=design.table.share,
        volume=choice.volume,
        seconds=choice.seconds,
        separations=separations,
        table=detect.detect(taken, taken.stated_law, request.effects, rng),
    )
    return chosen, poses_csv(measurement, series, covariates)


def _pool(
    candidates: GapProblem, rows: Sequence[Index], design: GapDesignRequest
) -> Separation:
    law = candidates.stated_law
    return pool_runs(candidates, law, rows, design.wanted, design.rivals)


def _add_earlier(
    pairs: Sequence[SeparationRecord], planned: GapProblem, design: GapDesignRequest
) -> list[SeparationRecord]:
    """Pairs with their separation in other planned readings, where these test it."""
    try:
        pool = _pool(planned, planned.members, design)
    except ValueError:
        return list(pairs)
    earlier = {
        (pair.effect, pair.rival, pair.words): pair.separation
        for pair in pool.pairs(np.arange(pool.count))
    }
    return [
        replace(pair, before=earlier.get((pair.effect, pair.rival, pair.words)))
        for pair in pairs
    ]


def _least_before(separations: Sequence[SeparationRecord]) -> float | None:
    """The least separation before; None where one of them is not known."""
    separations_before = [s.before for s in separations if s.before is not None]
    return (
        min(separations_before) if len(separations_before) == len(separations) else None
    )


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
