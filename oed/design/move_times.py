"""Times of moves between poses, and of changes from one set-up to another."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from oed.base import Array
from oed.measurement import Measurement, Series
from oed.model.instrument import Setup

#: settings that tell where an instrument stands
PLACE_SETTINGS = ("at_x", "at_y", "at_z")


def travel_times(before: Array, after: Array, speeds: ArrayLike) -> Array:
    """Seconds (n, m) from `before` (n, k) to `after` (m, k), joints or commands, SI.

    The time is the largest move over its speed (k,), or over one speed for all. Joints
    that move together at full speed take that; a straight move in the command takes
    longer.
    """
    speed = np.broadcast_to(np.asarray(speeds, dtype=float), before.shape[1:])
    if not (speed > 0.0).all():
        raise ValueError("speeds must be positive")
    return np.asarray(cdist(before / speed, after / speed, "chebyshev"))


def travel_between(
    measurement: Measurement, series: Series, speeds: ArrayLike
) -> Array:
    """Seconds (n, n) between the poses of the n readings of a series, by their joints.

    speeds (nq,), or one for all.
    """
    joints = series.q[series.index[:, 0]]
    return travel_times(joints, joints, speeds)


def travel_from_home(
    measurement: Measurement, series: Series, speeds: ArrayLike
) -> Array:
    """Seconds (n,) from home to the poses of a series; home has the reference tool."""
    _, q = measurement.kinematics.sent(measurement.machine.home_command)
    times = travel_times(q, series.q[series.index[:, 0]], speeds)
    return np.asarray(times[0])


@dataclasses.dataclass(frozen=True, slots=True)
class ChangeTimes:
    """Seconds to change parts of a set-up; another instrument is mounted anew.

    tool      to change the tool
    place     to move the cup, or the place or teach pose of the instrument
    settings  to change other settings, such as the bar's length
    """

    tool: float
    place: float
    settings: float


def remounting(setups: Sequence[Setup], changes: ChangeTimes) -> tuple[Array, Array]:
    """Seconds (S, S) to change from one set-up to another, and (S,) to mount each first."""
    first = np.array([s.instrument.cost.setup for s in setups], dtype=float)
    costs = np.zeros((len(setups), len(setups)))
    for i, before in enumerate(setups):
        for j, after in enumerate(setups):
            costs[i, j] = changes.tool * (before.tool != after.tool)
            if before.instrument.name != after.instrument.name:
                costs[i, j] += first[j]
            else:
                costs[i, j] += _change_time(before, after, changes)
    return costs, first


def _change_time(before: Setup, after: Setup, changes: ChangeTimes) -> float:
    """Seconds to change place and settings of one instrument."""
    changed = {
        name
        for name, value in after.settings.items()
        if before.settings.get(name) != value
    }
    moved = changed.intersection(PLACE_SETTINGS)
    place_changes = bool(moved) or before.teach != after.teach
    seconds = changes.place * place_changes
    return seconds + changes.settings * bool(changed - moved)
