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

from oed.base import units
from oed.base.arrays import Array, Index
from oed.gap.before.runs import CONDITIONS, Run
from oed.gap.data.problem import GapProblem
from oed.measurement.measurement import Series
from oed.model.instrument import Instrument

#: from the last reading to a second visit, s
PAUSE = 600.0
#: a path is read at every so many-th pose, and at no fewer poses than the shortest
STEPS, SHORTEST = (1, 2), 5
#: poses and conditions are alike to so many digits, SI
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
    start = _start(table)
    combinations = list(_combinations(table, further_values or {}))
    runs = [
        dataclasses.replace(run, condition=_at(run.condition, start))
        for run in further_runs
        if run.setup in problem.measurement.setups
        and run.condition.keys() - {"time"} == combinations[0].keys()
    ]
    for setup, label, command, seconds in _paths(problem, table):
        for stated, step in itertools.product(combinations, STEPS):
            condition = _at(stated, start)
            poses = command[::step]
            words = [f"{label} again", *_words(stated), *_every(step)]
            if len(poses) >= SHORTEST or step == 1:
                runs.append(
                    Run(
                        name=", ".join(words),
                        setup=setup,
                        command=poses,
                        condition=condition,
                        seconds=seconds,
                    )
                )
    return runs


def with_other_covariates(rows: pd.DataFrame, known: pd.DataFrame) -> pd.DataFrame:
    """Covariates of runs to come, with temperatures and tensions as read last."""
    others = [c for c in known if c not in (*rows, *CONDITIONS, "repeat")]
    last = {c: known[c].dropna() for c in others}
    return rows.assign(**{c: v.iloc[-1] if len(v) else np.nan for c, v in last.items()})


def _start(table: pd.DataFrame) -> float | None:
    """Time at which a second visit starts, s; None where no clock was read."""
    if "time" not in table or not table["time"].notna().any():
        return None
    return float(table["time"].max()) + PAUSE


def _at(condition: Mapping[str, float], start: float | None) -> dict[str, float]:
    """A condition at a time, where there is a clock."""
    untimed = {name: value for name, value in condition.items() if name != "time"}
    return untimed if start is None else {**untimed, "time": start}


def _combinations(
    table: pd.DataFrame, further: Mapping[str, Sequence[float]]
) -> Iterator[dict[str, float]]:
    """Conditions of the readings taken: all combinations of extreme values."""
    values: dict[str, list[float]] = {}
    if "direction" in table and table["direction"].notna().any():
        values["direction"] = [1.0, -1.0]
    for name in ("feed", "payload"):
        if name in table and table[name].notna().any():
            known = [*table[name].dropna(), *further.get(name, ())]
            values[name] = sorted({float(min(known)), float(max(known))})
    for chosen in itertools.product(*values.values()):
        yield dict(zip(values, chosen, strict=True))


def _paths(
    problem: GapProblem, table: pd.DataFrame
) -> Iterator[tuple[str, str, Array, float]]:
    """Set-up, run, commands in forward order, and duration (s) of each distinct path."""
    distinct: set[tuple[str, bytes]] = set()
    start = 0
    parts: list[tuple[str, str, Array, float, bool]] = []
    for series in problem.series:
        rows = table.iloc[start : start + len(series)]
        instrument = problem.measurement.setups[series.setup].instrument
        start += len(series)
        for label in dict.fromkeys(str(r) for r in series.run):
            members = np.flatnonzero(series.run == label)
            command = series.command[_poses(series, members, instrument)]
            if len(command) < 2 or np.isnan(command).any():
                continue
            of_run = rows.iloc[members]
            reverse = "direction" in of_run and (of_run["direction"] == -1).all()
            seconds = _duration(of_run)
            ordered = command[::-1] if reverse else command
            parts.append((series.setup, label, ordered, seconds, reverse))
    for setup, label, command, seconds, _ in sorted(parts, key=lambda part: part[-1]):
        places = np.unique(np.round(command, DIGITS), axis=0)
        if (setup, places.tobytes()) not in distinct:
            distinct.add((setup, places.tobytes()))
            yield setup, label, command, seconds


def _poses(series: Series, members: Index, instrument: Instrument) -> Index:
    """Poses of a run in order, its reference first where readings refer to that."""
    poses = series.index[members, 0]
    if instrument.reference == "run":
        poses = np.concatenate([series.index[members[:1], 1], poses])
    return np.asarray(poses)


def _duration(rows: pd.DataFrame) -> float:
    """Time that a run took, s; 0 where no clock was read."""
    if "time" not in rows:
        return 0.0
    span = rows["time"].max() - rows["time"].min()
    return float(span) if np.isfinite(span) else 0.0


def _words(condition: Mapping[str, float]) -> Sequence[str]:
    """A condition as parts of a run's name."""
    words = []
    if "payload" in condition:
        words.append(f"{condition['payload']:g} N")
    if "feed" in condition:
        words.append(f"{condition['feed'] / units.MM_PER_MIN:g} mm/min")
    if "direction" in condition:
        words.append(f"{condition['direction']:+.0f}")
    return words


def _every(step: int) -> Sequence[str]:
    return [] if step == 1 else ["every second pose"]
