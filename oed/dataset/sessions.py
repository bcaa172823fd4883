"""Tables of several sessions as those of one: run names of their own, and one clock."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from oed.dataset.readings_file import ReadingsFile

#: time between two sessions whose clocks both start at the beginning, s
BETWEEN: Final = 1.0


@dataclasses.dataclass(frozen=True)
class JoinedSessions:
    """Tables of all sessions in order.

    restarted  numbers of the sessions, from 1, whose clock starts again
    """

    tables: tuple[ReadingsFile, ...]
    restarted: tuple[int, ...]


def join(sessions: Sequence[Sequence[ReadingsFile]]) -> JoinedSessions:
    """Tables of sessions, the earliest first, as those of one session.

    A run whose name an earlier session uses in its set-up gets the number of its session.
    A clock that starts again counts on from the end of the session before.
    """
    joined: list[ReadingsFile] = []
    restarted: list[int] = []
    runs: set[tuple[str, str]] = set()
    end = -np.inf
    for number, tables in enumerate(sessions, start=1):
        start, last = _extent(tables)
        delay = 0.0
        if start <= end:
            delay = end + BETWEEN - start
            restarted.append(number)
        renamed = [_as_later(one, runs, number, delay) for one in tables]
        runs |= {key for one in renamed for key in _distinct_runs(one.frame)}
        end = max(end, last + delay)
        joined += renamed
    return JoinedSessions(tuple(joined), tuple(restarted))


def _extent(tables: Sequence[ReadingsFile]) -> tuple[float, float]:
    """First and last time of a session, s; (inf, -inf) where none is known."""
    clocks = [one.frame["time"] for one in tables if "time" in one.frame]
    times = np.concatenate([np.empty(0), *clocks])
    known = times[np.isfinite(times)]
    return float(known.min(initial=np.inf)), float(known.max(initial=-np.inf))


def _distinct_runs(frame: pd.DataFrame) -> set[tuple[str, str]]:
    """Set-up and run of the rows."""
    distinct = frame[["setup", "run"]].drop_duplicates()
    return set(zip(distinct["setup"], distinct["run"], strict=True))


def _as_later(
    one: ReadingsFile, runs: set[tuple[str, str]], number: int, delay: float
) -> ReadingsFile:
    """A table of a later session; `runs` are those of earlier ones."""
    frame = one.frame
    if runs & _distinct_runs(frame):
        names = [
            f"{run} (session {number})" if (setup, run) in runs else run
            for setup, run in zip(frame["setup"], frame["run"], strict=True)
        ]
        frame = frame.assign(run=names)
    if "time" in frame:
        frame = frame.assign(time=frame["time"] + delay)
    return dataclasses.replace(one, frame=frame)
