"""Times of readings that contradict their order, or each other.

clock    times of a run, and what a clock or a unit does to them
within   one run: backwards, jumps, another unit from a row on, one time for all rows
between  runs of a file: another unit, half a day too early, two poses at one time
"""

from __future__ import annotations

from oed.checks.findings import CheckFinding
from oed.checks.session import SessionReadings
from oed.checks.times import between, within
from oed.checks.times.clock import time_column, timed_runs

__all__ = ["wrong_times"]


def wrong_times(session: SessionReadings) -> list[CheckFinding]:
    """What is wrong with the times of a session; nothing where no reading has one.

    Runs are compared where each is in order by itself.
    """
    runs = timed_runs(session)
    column = time_column(session)
    findings = within.findings(runs, column)
    return findings or between.findings(runs, column)
