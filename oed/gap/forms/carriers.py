"""Carriers of a discrepancy: a channel's reading, a joint, the tool's place.

A carrier is the change of the readings per unit of a form at each pose that they see.
Its unit changes the readings by about their noise, whatever the machine's size.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from oed.base import Array
from oed.gap.data.problem import GapProblem
from oed.measurement import Series

#: names of the carriers whose columns are the joints and the channels' readings
JOINTS = "the joints"
READINGS = "the readings"


@dataclasses.dataclass(frozen=True)
class Carrier:
    """What a discrepancy acts on.

    name      in words
    columns   (N, c, J) change of the readings, in units of the noise; J are the poses
              that a reading sees
    labels    (c,) the block of each of its columns; "" where they belong together
    """

    name: str
    columns: Array
    labels: tuple[str, ...]

    @property
    def separable(self) -> bool:
        """Whether one of its columns may act without the others."""
        return len(self.labels) > 1 and all(self.labels)

    def parts(self) -> list[Carrier]:
        """Each of its columns alone, or all of them where they belong together."""
        if not self.separable:
            return [self]
        return [
            Carrier(part_in_words(label), self.columns[:, k, None], (label,))
            for k, label in enumerate(self.labels)
        ]


def part_in_words(label: str) -> str:
    """A part of a carrier by its label."""
    return label.replace("channel ", f"{READINGS} of ")


def every(problem: GapProblem) -> tuple[Carrier, ...]:
    """The readings, the joints, the tool's place and the tool's length."""
    slopes = _joint_slopes(problem)
    return (
        readings(problem),
        _joints(problem, slopes),
        _tool(problem, slopes),
        _tool_length(problem, slopes),
    )


def readings(problem: GapProblem) -> Carrier:
    """The readings of each channel in each set-up, whose instruments err by themselves."""
    return _by_name(problem, problem.rows["channel"] + " in " + problem.rows["setup"])


def channels(problem: GapProblem) -> Carrier:
    """The readings of each channel, in all set-ups alike."""
    return _by_name(problem, problem.rows["channel"])


def _by_name(problem: GapProblem, kinds: pd.Series) -> Carrier:
    """The readings of each kind by its name."""
    names, owner = np.unique(kinds.to_numpy(dtype=str), return_inverse=True)
    columns = np.zeros((len(problem), len(names), _most_poses(problem)))
    columns[np.arange(len(problem)), owner, 0] = 1.0
    labels = tuple(f"channel {name}" for name in names)
    return Carrier(READINGS, columns, labels)


def _joints(problem: GapProblem, slopes: Array) -> Carrier:
    """Each joint, from the readings' slopes (N, nq, J) over it."""
    labels = tuple(f"leg {i + 1}" for i in problem.states[0].limbs)
    return Carrier(JOINTS, _scaled(slopes), labels)


def _tool(problem: GapProblem, slopes: Array) -> Carrier:
    """The tool's place along the three axes of the base."""
    pushing = at_poses(problem, [s.joints_per_displacement for s in problem.states])
    columns = np.einsum("nqj,njqk->nkj", slopes, pushing)
    return Carrier("the tool", _scaled(columns), ("", "", ""))


def _tool_length(problem: GapProblem, slopes: Array) -> Carrier:
    """The tool along its own axis, as of a spindle that warms."""
    growth = at_poses(problem, [s.joints_per_extension for s in problem.states])
    columns = np.einsum("nqj,njq->nj", slopes, growth)
    return Carrier("the tool's length", _scaled(columns[:, None]), ("",))


def _scaled(columns: Array) -> Array:
    """Columns (N, c, J) with a root mean square of 1 on average."""
    mean_square = float((columns**2).sum(axis=2).mean())
    return np.asarray(columns / math.sqrt(mean_square)) if mean_square else columns


def _joint_slopes(problem: GapProblem) -> Array:
    """Slopes (N, nq, J) of the readings over the joints, over the noise, per SI unit."""
    parts, most = [], _most_poses(problem)
    for series, response in zip(problem.series, problem.responses, strict=True):
        at_pose = response.joints
        count, width = at_pose[0][..., 0].size, at_pose[0].shape[-1]
        part = np.zeros((count, width, most))
        for k, j in enumerate(_moving_poses(series)):
            part[:, :, k] = at_pose[j].reshape(count, -1)
        parts.append(part)
    return problem.in_noise_units(np.concatenate(parts))


def at_poses(problem: GapProblem, values: Sequence[Array]) -> Array:
    """Values (m, ...) at the poses of each series, as the readings see them (N, J, ...).

    First comes the pose read, then what it is read against. The last repeats where a
    reading sees fewer poses than others.
    """
    parts, most = [], _most_poses(problem)
    sources = zip(values, problem.series, problem.responses, strict=True)
    for value, series, response in sources:
        moving = _moving_poses(series)
        padding = [moving[-1]] * (most - len(moving))
        poses = series.index[:, [*moving, *padding]]
        channels = response.nuisances.shape[1]
        parts.append(np.repeat(value[poses], channels, axis=0))
    return np.concatenate(parts)


def apply_carrier(carrier: Array, forms: Array) -> Array:
    """Readings (N, c, k) of forms (N, J, k) on a carrier (N, c, J)."""
    poses = range(carrier.shape[2])
    return np.asarray(sum(carrier[:, :, j, None] * forms[:, None, j] for j in poses))


def _moving_poses(series: Series) -> list[int]:
    """Columns of its index with the poses that differ among a series' readings.

    A taught pose, which all readings share, is none of them.
    """
    places = enumerate(series.index.T)
    return [j for j, place in places if j == 0 or len(np.unique(place)) > 1]


def _most_poses(problem: GapProblem) -> int:
    return max(len(_moving_poses(series)) for series in problem.series)
