"""Readings of a thermal reference between the readings of a path.

Of all places that respect the longest time between two reference readings, those with
the least travel are taken, by dynamic programming along the path (Prins 2004, Comput.
Oper. Res. 31, 1985-2002, section 3).
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import ArrayLike

from oed.base import Array, Index, Mask
from oed.design.order import Route

#: relative tolerance of the longest time
TOLERANCE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Schedule:
    """Readings in time.

    pose     (m,) pose of each reading, -1 at the thermal reference
    begins   (m,) when each reading begins, s
    seconds  until the last reading ends
    """

    pose: Index
    begins: Array
    seconds: float

    @property
    def reference(self) -> Mask:
        """Which readings (m,) are of the thermal reference."""
        return self.pose < 0


def interleave(
    path: Route,
    reading: ArrayLike,
    every: float,
    to_reference: Array,
    from_reference: Array,
    reference_reading: float,
    begin: float = 0.0,
) -> Schedule:
    """The path with reference readings first, last, and at most `every` seconds apart.

    The time counts from the end of one reference reading to the begin of the next.

    path               whose lengths are seconds; runs are not broken up
    reading            (n,) seconds a reading by pose number, or one number
    to_reference       (n,) seconds from each pose to the reference pose
    from_reference     (n,) seconds from the reference pose
    reference_reading  seconds of a reference reading
    begin              when the machine stands at the reference

    Raises ValueError where a run alone takes longer than `every`.
    """
    by_pose = np.broadcast_to(np.asarray(reading, dtype=float), path.indices.shape)
    timed = _TimedPath(
        path,
        by_pose[path.indices],
        from_reference[path.indices],
        to_reference[path.indices],
        reference_reading,
    )
    return timed.schedule(timed.stretches(every), begin)


@dataclasses.dataclass(frozen=True, eq=False)
class _TimedPath:
    """A path with the seconds of each place.

    reading  (n,) of the readings
    out      (n,) from the reference
    back     (n,) to the reference
    """

    path: Route
    reading: Array
    out: Array
    back: Array
    reference_reading: float

    @functools.cached_property
    def ends(self) -> Array:
        """When each reading ends (n,), from the begin of the first move of the path."""
        return np.cumsum(self.path.steps + self.reading)

    def stretches(self, every: float) -> list[tuple[int, int]]:
        """Places (first, last + 1) between two reference readings, of least travel."""
        edges = self._run_edges()
        longest = every * (1.0 + TOLERANCE)
        least = np.full(len(edges), np.inf)
        least[0] = 0.0
        origin = np.zeros(len(edges), dtype=np.intp)
        for b in range(1, len(edges)):
            for a in range(b - 1, -1, -1):
                seconds = self._seconds_away(edges[a], edges[b])
                if seconds > longest:
                    if a == b - 1:
                        self._raise_too_long(edges[a], seconds, every)
                    continue
                total = least[a] + seconds + self.reference_reading
                if total < least[b]:
                    least[b], origin[b] = total, a
        stretches = []
        b = len(edges) - 1
        while b > 0:
            stretches.append((int(edges[origin[b]]), int(edges[b])))
            b = int(origin[b])
        return stretches[::-1]

    def _run_edges(self) -> Index:
        """First place of each run, and the number of places."""
        run, count = self.path.run, len(self.reading)
        if not count:
            return np.zeros(1, np.intp)
        starts = np.flatnonzero(np.append(True, run[1:] != run[:-1]))
        return np.append(starts, count)

    def _seconds_away(self, first: int, end: int) -> float:
        """Seconds between reference readings around the places first to end - 1."""
        until_first = self.out[first] + self.reading[first]
        until_last = until_first + self.ends[end - 1] - self.ends[first]
        return float(until_last + self.back[end - 1])

    def _raise_too_long(self, first: int, seconds: float, every: float) -> None:
        raise ValueError(
            f"the run of pose {self.path.indices[first]} takes {seconds:.6g} s with the"
            f" way from and to the reference, longer than {every:.6g} s: read the"
            " reference less often, or break the run up"
        )

    def schedule(self, stretches: list[tuple[int, int]], begin: float) -> Schedule:
        """All readings in time."""
        pose, begins = [-1], [begin]
        clock = begin + self.reference_reading
        for first, end in stretches:
            for place in range(first, end):
                move = self.out if place == first else self.path.steps
                clock += float(move[place])
                pose.append(int(self.path.indices[place]))
                begins.append(clock)
                clock += float(self.reading[place])
            clock += float(self.back[end - 1])
            pose.append(-1)
            begins.append(clock)
            clock += self.reference_reading
        return Schedule(np.array(pose, dtype=np.intp), np.array(begins), clock)
