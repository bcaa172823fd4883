"""Series of readings in one set-up: joints sent, poses each reading sees, runs."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oed.base import Array, Index, Mask
from oed.instrument.instrument import Protocol


@dataclasses.dataclass(frozen=True, slots=True)
class Series:
    """n readings taken, or to be taken, in one set-up, at m poses; SI.

    setup    name of the set-up
    q        (m, nq) joints sent to the machine, or (machines, m, nq): each its own
    start    (m, nx) nominal poses, or (draws, m, nx): Newton's start
    command  (m, n_dof) commands; NaN where joints were recorded instead
    index    (n, arity) poses that each reading sees: its own, then its reference
    run      (n,) label of the run (circle, line) of each reading
    sigma    (n, channels) standard deviation of each reading, NaN where it is that of the
             set-up; None where it is for all

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> series = measurement.series("tracker", np.array([[0.0, 0.5], [1.0, 0.5]]))
    >>> len(series), series.q.shape
    (2, (2, 2))
    >>> series.take(np.array([1])).command
    array([[1. , 0.5]])
    """

    setup: str
    q: Array
    start: Array
    command: Array
    index: Index
    run: NDArray[np.str_]
    sigma: Array | None = None

    def __len__(self) -> int:
        return int(self.index.shape[0])

    def take(self, rows: Index) -> "Series":
        """The readings `rows`, in that order, with only the poses they see."""
        poses, index = np.unique(self.index[rows], return_inverse=True)
        index = index.reshape(self.index[rows].shape).astype(np.intp)
        sigma = None if self.sigma is None else self.sigma[rows]
        return dataclasses.replace(
            self._at(poses), index=index, run=self.run[rows], sigma=sigma
        )

    def of_machines(self, machines: Index | int) -> "Series":
        """The readings of some machines, or of one, where each has its own joints."""
        if self.q.ndim == 2:
            return self
        return dataclasses.replace(self, q=self.q[machines], start=self.start[machines])

    def poses_of(self, chosen: Mask) -> Mask:
        """Which poses (m, poses) the chosen readings (m, n) see."""
        sees = np.zeros((len(self), len(self.command)))
        for poses in self.pose_indices():
            sees[np.arange(len(self)), poses] = 1.0
        return chosen @ sees > 0.0

    def expand_passes(self, protocol: Protocol) -> "Series":
        """All passes as runs, backward ones reversed, unless averaged."""
        if protocol.average or len(protocol.pass_names) == 1:
            return self
        rows, labels = [], []
        for run in dict.fromkeys(self.run):
            members = np.flatnonzero(self.run == run)
            for name in protocol.pass_names:
                backward = name.startswith("backward")
                rows.append(members[::-1] if backward else members)
                labels += [f"{run}, {name}"] * len(members)
        expanded = self.take(np.concatenate(rows))
        return dataclasses.replace(expanded, run=np.array(labels, dtype=np.str_))

    def separate_poses(self) -> "Series":
        """The same readings with a pose of its own for each.

        The passes of a run share poses, but not the machine's state. References stay
        shared: the teach pose by all readings, the first pose of a run by the run.
        """
        read, reference = self.index[:, 0], self.index[:, 1:]
        n = len(read)
        distinct, number = np.unique(reference, return_inverse=True)
        poses_seen = n + number.reshape(reference.shape)
        index = np.column_stack([np.arange(n), poses_seen]).astype(np.intp)
        separate = self._at(np.concatenate([read, distinct]))
        return dataclasses.replace(separate, index=index)

    def reading_commands(self) -> Array:
        """Command (n, n_dof) of the pose that each reading reads."""
        return self.command[self.index[:, 0]]

    def pose_indices(self) -> list[Index]:
        """For each pose of a reading (its own, its reference) the indices (n,)."""
        return [self.index[:, j] for j in range(self.index.shape[1])]

    def _at(self, poses: Index) -> "Series":
        """The series with `poses` in place of its poses; the index is left as it is."""
        return dataclasses.replace(
            self,
            q=self.q[..., poses, :],
            start=self.start[..., poses, :],
            command=self.command[poses],
        )

    def reading_sigma(self, stated: Sequence[float]) -> Array:
        """Standard deviation (n, channels), SI, of each reading: its own, or as stated."""
        common = np.tile(stated, (len(self), 1))
        if self.sigma is None:
            return common
        return np.where(np.isfinite(self.sigma), self.sigma, common)


@dataclasses.dataclass(frozen=True, eq=False)
class TakenReadings:
    """Some readings of a series."""

    whole: Series  #: the series
    part: Series  #: the readings `rows` of it
    rows: Index  #: (k,) in rising order

    @staticmethod
    def of_values(
        series: Sequence[Series], channels: Sequence[int], values: Index
    ) -> "tuple[list[TakenReadings], Index]":
        """The readings that some values belong to, and where these are among theirs (k,).

        channels  values of a reading of each series
        values    (k,) numbers of values, in rising order; a reading's follow each other
        """
        taken: list[TakenReadings] = []
        entries = []
        first = before = 0
        for s, count in zip(series, channels, strict=True):
            inside = (values >= first) & (values < first + len(s) * count)
            reading, channel = np.divmod(values[inside] - first, count)
            first += len(s) * count
            rows = np.unique(reading)
            if rows.size:
                taken.append(TakenReadings(s, s.take(rows), rows))
                entries.append(
                    before + np.searchsorted(rows, reading) * count + channel
                )
                before += len(rows) * count
        return taken, np.concatenate(entries).astype(np.intp)
