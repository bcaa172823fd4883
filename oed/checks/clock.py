"""Times that contradict the runs: a run is read without a break, one run at a time."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy import spatial

from oed.base.arrays import Array, Index
from oed.checks.session import SessionReadings

#: readings of a run from which on its times say something
LEAST = 3
#: joints are equal to so much of their largest difference, and share of equal poses from
#: which on two runs were read at once, by two instruments
SAME, AT_ONCE = 1e-6, 0.5


@dataclasses.dataclass(frozen=True)
class TimedRun:
    """A run with the times (n,) and joints (n, nq) of its readings, and their rows."""

    setup: str
    run: str
    time: Array
    joints: Array
    rows: Index

    @property
    def name(self) -> str:
        """The run with its set-up."""
        return f"{self.run} of {self.setup}"


@dataclasses.dataclass(frozen=True)
class Overlap:
    """Two runs that were read at the same time, from `begin` to `end`, s."""

    runs: tuple[TimedRun, TimedRun]
    begin: float
    end: float


def backward_runs(session: SessionReadings) -> list[tuple[TimedRun, int]]:
    """Runs whose times fall along their order, each with the first row that does."""
    backward = []
    for run in timed_runs(session):
        falls = np.flatnonzero(np.diff(run.time) < 0.0)
        if falls.size:
            backward.append((run, int(run.rows[falls[0] + 1])))
    return backward


def standing_runs(session: SessionReadings) -> list[TimedRun]:
    """Runs of several poses that have one time."""
    return [
        run
        for run in timed_runs(session)
        if np.ptp(run.time) == 0.0 and np.ptp(run.joints, axis=0).max() > 0.0
    ]


def overlapping_runs(session: SessionReadings) -> list[Overlap]:
    """Pairs of runs that share a time, and were not read at once by two instruments."""
    pairs = []
    for one, other in itertools.combinations(timed_runs(session), 2):
        begin = max(one.time.min(), other.time.min())
        end = min(one.time.max(), other.time.max())
        if begin < end and not _read_at_once(one, other):
            pairs.append(Overlap((one, other), float(begin), float(end)))
    return pairs


def timed_runs(session: SessionReadings) -> list[TimedRun]:
    """Runs with a time at each of at least LEAST readings, in their order."""
    frame = session.values
    if "time" not in frame.columns:
        return []
    joints = np.vstack([s.q[s.index[:, 0]] for s in session.series])
    reading, runs = session.reading_of_value, []
    groups = frame.groupby(["setup", "run"], sort=False).indices
    for (setup, run), members in groups.items():
        rows = frame.iloc[members].drop_duplicates("row").sort_values("order")
        time = rows["time"].to_numpy(dtype=float)
        if len(rows) < LEAST or not np.isfinite(time).all():
            continue
        path = joints[reading[rows.index.to_numpy()]]
        numbers = rows["row"].to_numpy(dtype=np.intp)
        runs.append(TimedRun(str(setup), str(run), time, path, numbers))
    return runs


def _read_at_once(one: TimedRun, other: TimedRun) -> bool:
    """Whether most poses of the shorter run are poses of the other one."""
    short, long = sorted((one, other), key=lambda run: len(run.time))
    size = max(float(np.ptp(long.joints, axis=0).max()), 1e-12)
    distance, _ = spatial.cKDTree(long.joints).query(short.joints, p=np.inf)
    return bool(np.mean(distance < SAME * size) >= AT_ONCE)
