"""Regions that a gap may be confined to, each as columns of what a fault there does."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.data.problem import GapProblem

#: change of a joint that legs' columns stand for, m (or rad): only its ratio among the
#: columns counts
UNIT = 1e-6


@dataclasses.dataclass(frozen=True, slots=True)
class Region:
    """What a fault at one place can do to the readings.

    kind     leg, set-up, run, time, phase or direction
    place    name of the block
    basis    (N, k) changes of the readings, in units of the noise
    cells    numbers of the cells of its kind that the place holds
    form     distinguishes regions at one place
    known    whether it asks where a known effect acts, a question of its own
    """

    kind: str
    place: str
    basis: Array
    cells: frozenset[int] = frozenset()
    form: str = ""
    known: bool = False

    def without_basis(self) -> Region:
        """The same place, whose basis is not kept."""
        return dataclasses.replace(self, basis=self.basis[:0])


def joint_change(problem: GapProblem, limb: int, change: Sequence[Array]) -> Array:
    """Readings (N, k), in units of the noise, per unit of k changes of a joint.

    `change` (m, k) is at the poses of each series.
    """
    parts = []
    sources = zip(problem.series, problem.responses, change, strict=True)
    for series, response, values in sources:
        readings, channels = response.nuisances.shape[:2]
        total = np.zeros((readings, channels, values.shape[1]))
        for slope, place in zip(response.joints, series.index.T, strict=True):
            by_joint = slope[:, :, limb, None]
            total += by_joint * values[place, None, :]
        parts.append(total.reshape(-1, values.shape[1]))
    return problem.in_noise_units(UNIT * np.concatenate(parts))


def channel_offsets(problem: GapProblem) -> Array:
    """One column (N, channels) for each kind of reading."""
    groups = np.unique(problem.channel)
    return np.asarray(problem.channel[:, None] == groups, dtype=float)


def runs(problem: GapProblem) -> Iterator[tuple[str, Array]]:
    """Name of each run, where there are several, and which readings (N,) it has."""
    if len(problem.members) < 2:
        return
    first = [members[0] for members in problem.members]
    labels = problem.rows[["setup", "run"]].iloc[first].astype(str)
    ambiguous = labels["run"].duplicated(keep=False).to_numpy()
    names = zip(labels["setup"], labels["run"], strict=True)
    for k, (setup, run) in enumerate(names):
        inside = np.zeros(len(problem))
        inside[problem.members[k]] = 1.0
        yield f"run {setup} {run}" if ambiguous[k] else f"run {run}", inside
