"""Times of a run, and what a clock that turns over or another unit does to them."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Mask
from oed.checks.session import SessionReadings
from oed.dataset.file_rows import Row

HOUR = 3600.0
#: times after which a clock begins again, s, with its remedy
HALF_DAY, DAY = 12.0 * HOUR, 24.0 * HOUR
#: times after which a display begins again, in words
TURNS = {
    HOUR: "the clock shows minutes and seconds alone",
    HALF_DAY: "a clock of 12 hours",
    DAY: "midnight passed",
}
#: seconds of the units that times may be in
UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": HOUR}
#: longest steps after which the next reading still follows
PAUSE = 3.0
#: ratio up to which steps are alike
ALIKE = 1.5
#: readings that a run with a cadence has at least
LEAST = 3
#: share of the range of a joint from which on two poses differ
APART = 1e-3


@dataclasses.dataclass(frozen=True)
class TimeColumn:
    """The column of the times: its name, its unit, and the seconds of that unit."""

    name: str
    unit: str
    factor: float

    def written(self, time: float) -> str:
        """A time, s, with the unit of the column."""
        return f"{time / self.factor:.7g} {self.unit}"

    @property
    def others(self) -> dict[str, float]:
        """Factors on times that are in another unit, by its name."""
        ratios = {unit: seconds / self.factor for unit, seconds in UNITS.items()}
        return {unit: ratio for unit, ratio in ratios.items() if unit != self.unit}


def time_column(session: SessionReadings) -> TimeColumn:
    """The column of the times of a session, in s where it came from no file."""
    if "time" not in session.columns:
        return TimeColumn("time_s", "s", 1.0)
    column = session.columns["time"]
    return TimeColumn(column.name, column.name.rpartition("_")[2], column.factor)


@dataclasses.dataclass(frozen=True, eq=False)
class TimedRun:
    """Readings of a run with a time, by their order.

    setup, run  names
    rows        (n,) in the files
    times       (n,) s
    joints      (n, nq) over their range in the session
    """

    setup: str
    run: str
    rows: Array
    times: Array
    joints: Array

    def __len__(self) -> int:
        return len(self.times)

    @property
    def name(self) -> str:
        """`run c1 of cup`."""
        return f"run {self.run} of {self.setup}"

    @property
    def start(self) -> float:
        """The first time, s."""
        return float(self.times.min())

    @property
    def end(self) -> float:
        """The last time, s."""
        return float(self.times.max())

    @property
    def cadence(self) -> float:
        """Usual time from reading to reading, s."""
        return typical(np.diff(self.times))

    @property
    def least_step(self) -> float:
        """Shortest time from one reading to the next, s."""
        steps = np.diff(np.unique(self.times))
        return float(steps.min()) if steps.size else 0.0

    def rows_from(self, first: int = 0) -> tuple[Row, ...]:
        """Rows of the files from a reading on."""
        return tuple(self.rows[first:].tolist())

    def scaled(self, factor: float, later: float = 0.0) -> TimedRun:
        """The run with times times a factor, and later by an amount, s."""
        return dataclasses.replace(self, times=factor * self.times + later)


def typical(steps: Array) -> float:
    """Median (s) of the steps forward; 0 for none."""
    forward = steps[steps > 0.0]
    return float(np.median(forward)) if forward.size else 0.0


def alike(one: float, other: float) -> bool:
    """Whether two steps, s, are alike."""
    least, most = sorted((one, other))
    return 0.0 < most <= ALIKE * least


def are_apart(one: Array, other: Array) -> Mask:
    """Mask (n,) of the poses (n, nq) that differ from others."""
    return np.asarray(np.abs(one - other).max(axis=1) > APART)


def timed_runs(session: SessionReadings) -> list[TimedRun]:
    """The runs of a session in the order of the file, with the readings that have a time."""
    if "time" not in session.values:
        return []
    joints = session.joints / np.maximum(np.ptp(session.joints, axis=0), 1e-12)
    runs = []
    for setup, run, every in session.ordered_runs():
        ordered = every.dropna(subset="time")
        times = ordered["time"].to_numpy(dtype=float)
        places = joints[ordered["reading"].to_numpy()]
        if len(times):
            rows = ordered["row"].to_numpy()
            runs.append(TimedRun(setup, run, rows, times, places))
    return sorted(runs, key=lambda one: one.rows.min())
