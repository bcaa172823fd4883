"""Chooses the runs of [gap.design], which separate the wanted effects best."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import dataset
from oed.arrays import Array
from oed.gap.before import choose, runs
from oed.gap.before.choose import RunChoice
from oed.gap.before.pool import PairSeparation, Pool
from oed.gap.before.runs import Run
from oed.gap.data import problem
from oed.gap.data.problem import GapProblem
from oed.measurement import Measurement, Series
from oed.noise.law import stated_law
from oed.result.gap_before import (
    ChosenRun,
    ChosenRuns,
    DetectabilityTable,
    SeparationRecord,
)
from pkm_studies.resolve.gap_design import GapDesignRequest

if TYPE_CHECKING:
    import pandas as pd

Pair = tuple[str, str, str]


@dataclasses.dataclass(frozen=True)
class ChosenPlan:
    """The chosen runs, retained ones among them.

    request    what [gap.design] requests
    choice     positions of the chosen runs, and their certificate
    selected   the chosen runs
    before     sqrt(lambda) of each pair in the readings planned without [gap.design]
    problem    the chosen runs as planned readings
    poses_csv  the chosen runs as a readings file to fill in
    """

    request: GapDesignRequest
    choice: RunChoice
    selected: tuple[Run, ...]
    before: Mapping[Pair, float]
    problem: GapProblem
    poses_csv: str

    def record(self, table: DetectabilityTable) -> ChosenRuns:
        """The choice for the result; `table` is the detectability in its runs."""
        request, choice = self.request, self.choice
        separations = [
            SeparationRecord(
                effect=pair.effect,
                rival=pair.rival,
                words=pair.words,
                detectability=pair.detectability,
                separation=pair.separation,
                before=self.before.get(_key(pair)),
            )
            for pair in choice.pairs
        ]
        records = [
            ChosenRun(run.setup, run.name, dict(run.condition), run.seconds)
            for run in self.selected
        ]
        return ChosenRuns(
            candidates=len(request.runs) - len(request.retained),
            retained=len(request.retained),
            runs=records,
            separation=choice.separation,
            bound=choice.bound,
            before=_least_before(separations),
            efficiency=choice.efficiency,
            proven=choice.proven,
            share=request.table.share,
            volume=choice.volume,
            seconds=choice.seconds,
            separations=separations,
            table=table,
        )


def choose_runs(
    measurement: Measurement,
    request: GapDesignRequest,
    planned: GapProblem,
    gravity: tuple[float, float, float],
    rng: np.random.Generator,
) -> ChosenPlan:
    """The runs that separate the wanted effects best from each other and from rivals.

    Raises InputError where no run shows them or the rules allow no plan.
    """
    assert request.rules is not None, "the plan to follow is made before"
    candidates, rows = runs.prepare(measurement, request.runs, gravity=gravity)
    try:
        pool = Pool(
            candidates, stated_law(candidates), rows, request.wanted, request.rivals
        )
        choice = choose.choose(
            pool,
            request.rules,
            rng,
            share=request.table.share,
            fixed=np.array(request.retained, dtype=np.intp),
            rounds=request.table.starts,
        )
    except ValueError as error:
        remedy = "give conditions that show it, or other effects or rules"
        raise request.place.error(str(error), remedy) from error
    selected = tuple(request.runs[k] for k in choice.runs)
    series, covariates = runs.lay_out(measurement, selected)
    timed = covariates
    if "time" not in covariates:
        timed = covariates.assign(time=_times(covariates, request))
    return ChosenPlan(
        request=request,
        choice=choice,
        selected=selected,
        before=_separation_before(planned, request),
        problem=problem.assemble(measurement, series, timed, gravity=gravity),
        poses_csv=_poses_csv(measurement, series, covariates),
    )


def _key(pair: PairSeparation) -> Pair:
    return pair.effect, pair.rival, pair.words


def _separation_before(
    planned: GapProblem, request: GapDesignRequest
) -> dict[Pair, float]:
    """sqrt(lambda) of each pair in other planned readings; none where untestable."""
    blocks = planned.members
    try:
        pool = Pool(
            planned, stated_law(planned), blocks, request.wanted, request.rivals
        )
    except ValueError:
        return {}
    return {
        _key(pair): pair.separation
        for pair in pool.pair_separations(np.arange(len(blocks)))
    }


def _least_before(separations: Sequence[SeparationRecord]) -> float | None:
    """The least separation before; None where one of them is not known."""
    known = [s.before for s in separations if s.before is not None]
    if not known or len(known) < len(separations):
        return None
    return min(known)


def _times(covariates: pd.DataFrame, request: GapDesignRequest) -> Array:
    """Time of each reading (n,), s, where the runs follow one another."""
    seconds = {(run.setup, run.name): run.seconds for run in request.runs}
    mounting = _mounting_times(request)
    clock, mounted, times = 0.0, "", []
    for (setup, name), rows in covariates.groupby(["setup", "run"], sort=False):
        clock += mounting[setup] if setup != mounted else 0.0
        mounted = setup
        duration = seconds[setup, name]
        times.append(clock + duration * np.arange(1, len(rows) + 1) / len(rows))
        clock += duration
    return np.concatenate(times)


def _mounting_times(request: GapDesignRequest) -> dict[str, float]:
    """Time to mount each set-up, s; 0 where the runs have stated times."""
    setups = dict.fromkeys(run.setup for run in request.runs)
    cost = None if request.rules is None else request.rules.setup_cost
    if cost is None:
        return dict.fromkeys(setups, 0.0)
    return dict(zip(setups, cost.tolist(), strict=True))


def _poses_csv(
    measurement: Measurement, series: Sequence[Series], covariates: pd.DataFrame
) -> str:
    """The chosen runs as a readings file; readings and times are to be filled in."""
    columns = covariates.drop(columns=["setup", "run", "order"]).assign(time=np.nan)
    empty = np.full(len(measurement.setup_of_readings(series)), np.nan)
    return dataset.to_csv(dataset.from_series(series, empty, measurement, columns))
