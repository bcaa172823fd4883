"""Rate, acceleration, sense and distance since reversal of the joints along each run.

A run is a smooth path through its poses. It is closed where it ends as near to its
start as one pose is to the next; a closed run is entered rolling. A joint may turn back
between two readings, so that the path locates the reversal, not the steps. At a reading
where a joint turns back, its sense is that in which it arrived: play is not yet taken up
there, and the slope, zero but for rounding, has no sign to go by. Between poses that
are points and no path, joints move straight, and the last step has their sense.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from oed.arrays import Array, Index

#: poses of a run from which on a path is laid through them
LEAST = 4
#: median turn of the tool's direction at the poses beyond which poses are points and no
#: path, rad
CORNER = np.deg2rad(50.0)
#: distance from end to start of a closed run, in steps between its poses
CLOSED = 1.5
#: last part of a step between poses over which the sense of arrival is taken
ARRIVAL = 0.02


@dataclasses.dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the joints at every pose, (m, nq) each, as in `State`.

    sense           sign of the joint's last motion
    rate            per second; NaN where the feed is not known
    acceleration    per second squared; NaN where the feed is not known
    reversal        distance since the joint last turned back
    """

    sense: Array
    rate: Array
    acceleration: Array
    reversal: Array


def motion(
    q: Array,
    tip: Array,
    run: NDArray[np.str_],
    order: Array,
    feed: Array,
    still: Index,
) -> Motion:
    """Motion of joints q (m, nq) from the order of poses in each run and its feed.

    The tool is at tip (m, 3); at the poses `still` the machine stands.
    """
    sense = np.zeros(q.shape)
    reversal = np.zeros(q.shape)
    rate = np.full(q.shape, np.nan)
    acceleration = np.full(q.shape, np.nan)
    rate[still] = acceleration[still] = 0.0
    moving = np.setdiff1d(np.arange(len(q)), still)
    for label in dict.fromkeys(run[moving]):
        at = moving[run[moving] == label]
        at = at[np.argsort(order[at], kind="stable")]
        if len(at) < 2:
            rate[at] = acceleration[at] = 0.0
            continue
        length, closed = _path_length(tip[at])
        places = length[: len(at)]
        path = _path(q[at], tip[at], length, closed)
        if path is None:
            slope = np.gradient(q[at], places, axis=0)
            curvature = np.gradient(slope, places, axis=0)
            sense[at] = _sense(np.diff(q[at], axis=0, prepend=q[at][:1]))
            reversal[at] = _since_reversal_by_steps(q[at], sense[at])
        else:
            slope = path(places, 1)
            curvature = path(places, 2)
            approach = ARRIVAL * _steps_before(length, len(at))
            arriving = path(places) - path(places - approach)
            sense[at] = _sense(arriving / approach[:, None])
            reversal[at] = _since_reversal(path, length, places - approach / 2, closed)
        speed = feed[at, None]
        rate[at] = slope * speed
        acceleration[at] = curvature * speed**2
    return Motion(sense, rate, acceleration, reversal)


def _path_length(tip: Array) -> tuple[Array, bool]:
    """Length of path at k poses, and whether the run is closed.

    A closed run has k + 1 values: the last is the length back at the first pose.
    """
    steps = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    steps = np.maximum(steps, 1e-9)
    last = float(np.linalg.norm(tip[0] - tip[-1]))
    near = 1e-6 < last < CLOSED * float(np.median(steps))
    closed = len(tip) >= 2 * LEAST and near
    lengths = np.cumsum([*steps, last] if closed else steps)
    return np.concatenate([[0.0], lengths]), closed


def _path(
    q: Array,
    tip: Array,
    length: Array,
    closed: bool,
) -> CubicSpline | None:
    """Joints over the length of path; None where the poses are points and no path."""
    step = np.diff(tip, axis=0)
    size = np.linalg.norm(step, axis=1)
    if len(q) < LEAST or size.min() < 1e-6:
        return None
    cosine = (step[1:] * step[:-1]).sum(axis=1) / (size[1:] * size[:-1])
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    if np.median(turn) > CORNER:
        return None
    if closed:
        around = np.vstack([q, q[:1]])
        return CubicSpline(length, around, bc_type="periodic")
    return CubicSpline(length, q)


def _steps_before(length: Array, count: int) -> Array:
    """Length of path (count,) from the pose before to each pose.

    A closed run's first pose follows its last; before that of an open run nothing is
    known, so the first step stands in.
    """
    steps = np.diff(length)
    first = steps[-1] if len(length) > count else steps[0]
    return np.concatenate([[first], steps])[:count]


def _sense(moved: Array) -> Array:
    """Signs of the joints' motion (k, nq); where one stands still, of its last motion."""
    size = np.abs(moved)
    least = 1e-6 * max(float(size.max()), 1e-12)
    sign = np.where(size > least, np.sign(moved), 0.0)
    count = len(sign)
    for k in range(1, count):
        _fill(sign, k, k - 1)
    for k in range(count - 2, -1, -1):
        _fill(sign, k, k + 1)
    return sign


def _fill(sign: Array, k: int, neighbour: int) -> None:
    """Replace zeros in row k by the neighbouring row's signs."""
    sign[k] = np.where(sign[k] == 0.0, sign[neighbour], sign[k])


def _since_reversal(
    path: CubicSpline,
    length: Array,
    arrival: Array,
    closed: bool,
) -> Array:
    """Distance (k, nq) since the path last turned back, before it arrives at k poses.

    arrival  (k,) lengths of path up to which a turn counts

    Before an open run's first turn it is infinite.
    """
    q = path(length[: len(arrival)])
    distance = np.full(q.shape, np.inf)
    roots = path.derivative().roots(extrapolate=False)
    for joint, turns in enumerate(roots):
        turns = np.unique(turns[np.isfinite(turns)])
        if closed:
            turns = np.concatenate([turns - length[-1], turns])
        last = np.searchsorted(turns, arrival, side="right") - 1
        turned = last >= 0
        at_turn = path(turns[last[turned]])[:, joint]
        distance[turned, joint] = np.abs(q[turned, joint] - at_turn)
    return distance


def _since_reversal_by_steps(q: Array, sense: Array) -> Array:
    """Distance (k, nq) since the last change of sense, summed over steps.

    Before a run's first change of sense it is infinite.
    """
    step = np.abs(np.diff(q, axis=0, prepend=q[:1]))
    distance = np.full(q.shape, np.inf)
    for k in range(1, len(q)):
        onward = sense[k] == sense[k - 1]
        distance[k] = np.where(onward, distance[k - 1] + step[k], step[k])
    return distance
