"""Readings grouped in runs: whose noise may be correlated, and how far apart they are.

A run is a circle, a line, a series of poses read without a break. Noise is independent
between runs; within a run it may share a level, a set-up unknown that was seated anew,
or an error that is carried along.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy import sparse

from oed.base.arrays import Array, Index
from oed.noise.stated import StatedErrors


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RunLayout:
    """An order of k readings, segment after segment; segments are independent.

    order   (k,) numbers of the readings
    starts  (S,) first place of each segment in it
    before  (k,) place of the reading before in the run and channel; its own for the
            first
    unit    (k,) what single readings have, and `unmix` (k, k) sparse, what their channels
            are made independent by, as in `StatedErrors.unmixing`
    """

    order: Index
    starts: Index
    before: Index
    unit: Array
    unmix: sparse.csr_array | None

    def decay(self, position: Array, length: float) -> Array:
        """Correlation (k,) with the reading before, over a length; 0 for the first.

        position  (N,) of each reading along its run
        """
        place = position[self.order]
        decay = np.exp((place[self.before] - place) / length)
        decay[self.before == np.arange(len(place))] = 0.0
        return np.asarray(decay)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Runs:
    """N readings in runs.

    stated    stated errors that are not independent; None where all are
    members   index set of each run
    position  (N,) number of each reading in its run, from 0
    channel   (N,) instrument channel of each reading: each has a noise level of its own
    seat      (N, s) slopes over the unknowns that a run seats anew, of one unit with the
              readings; (N, 0) where there are none
    level     (N,) 1 where the level of a run may move a reading by an unknown size, or
              0; None: ones
    """

    stated: StatedErrors | None
    members: tuple[Index, ...]
    position: Array
    channel: Index
    seat: Array
    level: Array | None = None

    def __len__(self) -> int:
        return len(self.position)

    @property
    def longest(self) -> int:
        """Length of the longest run, in steps of `position`."""
        return 1 + max(int(np.ptp(self.position[m])) for m in self.members)

    @property
    def levels(self) -> Array:
        """`level`, ones by default."""
        return np.ones(len(self)) if self.level is None else self.level

    @functools.cached_property
    def layout(self) -> RunLayout:
        """All readings, runs of one length together; channels apart where independent."""
        return self._layout(self.members)

    def layout_of(self, rows: Index) -> RunLayout:
        """The same of some readings."""
        counted = np.zeros(len(self), dtype=bool)
        counted[rows] = True
        some = [members[counted[members]] for members in self.members]
        return self._layout([members for members in some if members.size])

    def _layout(self, runs: Sequence[Index]) -> RunLayout:
        by_size: dict[int, list[Index]] = {}
        for run in runs:
            parts = [run]
            if self.stated is None:
                channel = self.channel[run]
                parts = [run[channel == g] for g in np.unique(channel)]
            for part in parts:
                ordered = part[np.argsort(self.position[part], kind="stable")]
                by_size.setdefault(len(part), []).append(ordered)
        segments = [segment for alike in by_size.values() for segment in alike]
        starts = np.cumsum([0, *(len(segment) for segment in segments)])
        before = [
            start + _same_before(self.channel[segment])
            for segment, start in zip(segments, starts, strict=False)
        ]
        order = np.concatenate(segments)
        unit, unmix = np.ones(len(order)), None
        if self.stated is not None:
            unit, unmix = self.stated.unmixing(order)
        return RunLayout(
            order=order,
            starts=starts[:-1],
            before=np.concatenate(before),
            unit=unit,
            unmix=unmix,
        )


def _same_before(channel: Index) -> Index:
    """Place (k,) of the last reading before of the same channel; its own for the first."""
    before = np.arange(len(channel))
    for g in np.unique(channel):
        at = np.flatnonzero(channel == g)
        before[at[1:]] = at[:-1]
    return before
