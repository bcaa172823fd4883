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

from oed.arrays import Array, Index, Mask


@dataclasses.dataclass(frozen=True, slots=True)
class RunBatch:
    """B runs of the same number k of readings, so that their matrices are one array.

    members       (B, k) which readings
    correlation   (B, k, k) stated by the instrument
    same_channel  (B, k, k) whether two readings are of one channel
    distance      (B, k, k) how many readings lie between them
    level         (B, k, k) 1 where a run's level of unknown size moves both, or 0
    seat          (B, k, k) what a seating shift of unit variance does to both
    """

    members: Index
    stated_correlation: Array
    same_channel: Mask
    distance: Array
    level: Array
    seat: Array

    def take(self, rows: Index) -> RunBatch:
        """The readings at positions `rows` (k',) of each run."""
        pairs = (slice(None), rows[:, None], rows)
        return RunBatch(
            members=self.members[:, rows],
            stated_correlation=self.stated_correlation[pairs],
            same_channel=self.same_channel[pairs],
            distance=self.distance[pairs],
            level=self.level[pairs],
            seat=self.seat[pairs],
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Runs:
    """N readings in runs.

    base     stated correlation of each run's readings, (k, k), or None where independent
    blocks   index set of each run
    along    (N,) number of each reading in its run, from 0
    group    (N,) instrument channel of each reading: each has a noise level of its own
    seat     (N, s) slopes over the unknowns that a run seats anew, of one unit with the
             readings; (N, 0) where there are none
    level    (N,) 1 where the level of a run may move a reading by an unknown size, or 0;
             None: ones
    """

    stated_correlation: tuple[Array | None, ...]
    members: tuple[Index, ...]
    position: Array
    channel: Index
    seat: Array
    level: Array | None = None

    def __len__(self) -> int:
        return len(self.position)

    @functools.cached_property
    def batches(self) -> tuple[RunBatch, ...]:
        """All runs, those of one length together; channels apart where independent."""
        by_size: dict[int, list[tuple[Index, Array | None]]] = {}
        for members, correlation in zip(
            self.members, self.stated_correlation, strict=True
        ):
            parts = [members]
            if correlation is None:
                channel = self.channel[members]
                parts = [members[channel == g] for g in np.unique(channel)]
            for part in parts:
                by_size.setdefault(len(part), []).append((part, correlation))
        return tuple(self._batch(parts) for parts in by_size.values())

    def batch(self, number: int) -> RunBatch:
        """One run, by its number."""
        return self._batch([(self.members[number], self.stated_correlation[number])])

    def _batch(self, parts: Sequence[tuple[Index, Array | None]]) -> RunBatch:
        members = np.array([part for part, _ in parts])
        size = members.shape[1]
        stated = [np.eye(size) if known is None else known for _, known in parts]
        channel, along = self.channel[members], self.position[members]
        seat = self.seat[members]
        level = np.ones(len(self)) if self.level is None else self.level
        moved = level[members]
        return RunBatch(
            members=members,
            stated_correlation=np.array(stated),
            same_channel=channel[:, :, None] == channel[:, None, :],
            distance=np.abs(along[:, :, None] - along[:, None, :]),
            level=moved[:, :, None] * moved[:, None, :],
            seat=seat @ seat.transpose(0, 2, 1),
        )
