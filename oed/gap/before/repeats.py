"""Candidate runs of a second visit: the runs of the first under other conditions.

Each path that was read is a candidate, at all of its poses and at every second one, in
both directions, at the least and the largest feed and payload that were used, as far as
the readings state them. Further values of these can be given, and further runs. All
start a pause after the last reading.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from oed import units
from oed.base import Array, Index
from oed.gap.before.runs import CONDITIONS, Run
from oed.gap.data.problem import GapProblem
from oed.measurement import Series

#: from the last reading to a second visit, s
PAUSE = 600.0
#: a path is read at every so many-th pose, and at no fewer poses than the shortest
STEPS, SHORTEST = (1, 2), 5
#: poses are alike to so many digits, SI
DIGITS = 7


def candidate_runs(
    problem: GapProblem,
    further_values: Mapping[str, Sequence[float]] | None = None,
    further_runs: Sequence[Run] = (),
) -> list[Run]:
    """Each path of a problem under each condition; those of recorded joints are none.

    further_values  feeds and payloads that are possible beside those of the readings
    further_runs    runs that are possible beside the paths; those under conditions that
                    the readings do not state, or in other set-ups, are none
    """
    table = problem.covariates.reset_index(drop=True)
    clock = {}
    if _is_known(table, "time"):
        clock = {"time": float(table["time"].max()) + PAUSE}
    conditions = list(_conditions(table, further_values or {}))
    runs = []
    for run in further_runs:
        stated = {name: v for name, v in run.condition.items() if name != "time"}
        known = run.setup in problem.measurement.setups
        if known and stated.keys() == conditions[0].keys():
            runs.append(dataclasses.replace(run, condition=stated | clock))
    for path in _paths(problem, table):
        for stated, step in itertools.product(conditions, STEPS):
            poses = path.command[::step]
            if len(poses) >= SHORTEST or step == 1:
                words = [f"{path.name} again", *_words(stated)]
                words += ["every second pose"] if step > 1 else []
                name, condition = ", ".join(words), stated | clock
                runs.append(
                    dataclasses.replace(
                        path, name=name, command=poses, condition=condition
                    )
                )
    return runs


def with_other_covariates(rows: pd.DataFrame, known: pd.DataFrame) -> pd.DataFrame:
    """Covariates of runs to come, with temperatures and tensions as read last."""
    others = [c for c in known if c not in (*rows, *CONDITIONS, "repeat")]
    last = {c: known[c].dropna() for c in others}
    return rows.assign(**{c: v.iloc[-1] if len(v) else np.nan for c, v in last.items()})


def _is_known(table: pd.DataFrame, name: str) -> bool:
    return name in table and bool(table[name].notna().any())


def _conditions(
    table: pd.DataFrame, further: Mapping[str, Sequence[float]]
) -> Iterator[dict[str, float]]:
    """Conditions of the readings taken: all combinations of extreme values."""
    values: dict[str, list[float]] = {}
    if _is_known(table, "direction"):
        values["direction"] = [1.0, -1.0]
    for name in ("feed", "payload"):
        if _is_known(table, name):
            known = [*table[name].dropna(), *further.get(name, ())]
            values[name] = sorted({float(min(known)), float(max(known))})
    for chosen in itertools.product(*values.values()):
        yield dict(zip(values, chosen, strict=True))


def _paths(problem: GapProblem, table: pd.DataFrame) -> list[Run]:
    """The distinct paths, with commands in forward order; the first run of each counts."""
    forward: list[Run] = []
    backward: list[Run] = []
    start = 0
    for series in problem.series:
        rows = table.iloc[start : start + len(series)]
        start += len(series)
        for label in dict.fromkeys(str(r) for r in series.run):
            members = np.flatnonzero(series.run == label)
            command = series.command[_poses(problem, series, members)]
            if len(command) < 2 or np.isnan(command).any():
                continue
            of_run = rows.iloc[members]
            reverse = "direction" in of_run and (of_run["direction"] == -1).all()
            seconds = 0.0
            if _is_known(of_run, "time"):
                seconds = float(of_run["time"].max() - of_run["time"].min())
            run = Run(
                name=label,
                setup=series.setup,
                command=command[::-1] if reverse else command,
                seconds=seconds,
            )
            (backward if reverse else forward).append(run)
    distinct: dict[tuple[str, bytes], Run] = {}
    for run in [*forward, *backward]:
        places = np.unique(np.round(run.command, DIGITS), axis=0)
        distinct.setdefault((run.setup, places.tobytes()), run)
    return list(distinct.values())


def _poses(problem: GapProblem, series: Series, members: Index) -> Array:
    """Poses of a run in order, its reference first where readings refer to that."""
    poses = series.index[members, 0]
    if problem.measurement.setups[series.setup].instrument.reference == "run":
        poses = np.concatenate([series.index[members[:1], 1], poses])
    return np.asarray(poses)


def _words(condition: Mapping[str, float]) -> Iterator[str]:
    """A condition as parts of a run's name."""
    if "payload" in condition:
        yield f"{condition['payload']:g} N"
    if "feed" in condition:
        yield f"{condition['feed'] / units.MM_PER_MIN:g} mm/min"
    if "direction" in condition:
        yield f"{condition['direction']:+.0f}"
