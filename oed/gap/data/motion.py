"""Rate, acceleration, sense and distance since reversal of the joints along each run.

A run is a smooth path through its poses. It is closed where it ends as near to its
start as one pose is to the next; a closed run is entered rolling. A joint may turn back
between two readings, so that the path locates the reversal, not the steps. At a reading
where a joint turns back, its sense is that in which it arrived: play is not yet taken up
there, and the slope, zero but for rounding, has no sign to go by. Between poses that
are points and no path, joints move straight, and the last step has their sense.

A corner ends a path: the machine arrives there as it came, and sets out anew. So does a
step much longer than the others, which only brings the machine to the start of a path;
a path that begins so is entered rolling, as ISO 230-2 has it.

The feed is the speed of the tool point. Where the tool turns and its point hardly moves,
it is the speed at the machine's lever about that point. So a step of length ds takes
ds / feed, with ds the larger of both chords: joint rates stay those of the machine.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import scipy  # its parts load when first used: plans need no path
from numpy.typing import NDArray

from oed.base import Array, Index, rows_by_label

#: poses of a run from which on a path is laid through them
LEAST = 4
#: median turn of the tool's direction at the poses beyond which poses are points and no
#: path, rad
CORNER = np.deg2rad(50.0)
#: distance from end to start of a closed run, in steps between its poses
CLOSED = 1.5
#: length of a step, in median steps of its run, from which on it belongs to no path
FAR = 3.0
#: length of a step, in the longest of its run, up to which the machine stands still
STILL = 1e-5
#: last part of a step between poses over which the sense of arrival is taken
ARRIVAL = 0.02


@dataclasses.dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the joints at every pose, (m, nq) each, as in `State`.

    sense           sign of the joint's last motion
    rate            per second; NaN where the feed is not known, and in runs in which
                    the tool neither moves nor turns
    acceleration    per second squared; NaN likewise
    reversal        distance since the joint last turned back
    """

    sense: Array
    rate: Array
    acceleration: Array
    reversal: Array


def motion(
    q: Array,
    place: Array,
    run: NDArray[np.str_],
    order: Array,
    feed: Array,
    still: Index,
) -> Motion:
    """Motion of joints q (m, nq) from the order of poses in each run and its feed.

    The tool is at place (m, 12) of `tool_places`; at the poses `still` the machine stands.
    """
    shape = q.shape
    sense, reversal = np.zeros(shape), np.zeros(shape)
    rate, acceleration = np.full(shape, np.nan), np.full(shape, np.nan)
    rate[still] = acceleration[still] = 0.0
    moving = np.setdiff1d(np.arange(len(q)), still)
    for members in rows_by_label(run[moving]):
        at = moving[members]
        at = at[np.argsort(order[at], kind="stable")]
        if len(at) < 2:
            rate[at] = acceleration[at] = 0.0
            continue
        along = _along_run(q[at], place[at])
        sense[at], reversal[at] = along.sense, along.reversal
        speed = feed[at, None]
        rate[at] = along.rate * speed
        acceleration[at] = along.acceleration * speed**2
    return Motion(sense, rate, acceleration, reversal)


def tool_places(tip: Array, rotation: Array, lever: float) -> Array:
    """Tool points (m, 3), then the tool's axes (m, 9) so that they turn at a lever; m.

    rotation  (m, 3, 3) of the tool

    Axes turned by an angle t are 2 sin(t / 2) apart times the lever: R and R' differ by
    2 sqrt(2) sin(t / 2) in the Frobenius norm.
    """
    axes = (lever / np.sqrt(2.0)) * rotation.reshape(len(rotation), 9)
    return np.hstack([tip, axes])


def _distance(move: Array) -> Array:
    """Length (k,) of moves (k, 12): of the tool point, or at the lever about it."""
    point = np.linalg.norm(move[:, :3], axis=1)
    return np.asarray(np.maximum(point, np.linalg.norm(move[:, 3:], axis=1)))


def _along_run(q: Array, place: Array) -> Motion:
    """Motion of a run's k >= 2 poses, in their order, over the length of path.

    Rate and acceleration are the first and second derivative over it.
    """
    tip = place[:, :3]
    along = _straight(q, place)
    if not _is_path(tip):
        return along
    corners, far = _breaks(tip)
    pieces = np.split(np.arange(len(q)), far)
    for points in pieces:
        inside = corners[np.isin(corners, points[1:-1])]
        start, rolling = int(points[0]), True
        for stop in (*inside, points[-1]):
            _lay_path(along, q, place, np.arange(start, stop + 1), rolling)
            start, rolling = int(stop), False
    return along


def _straight(q: Array, place: Array) -> Motion:
    """Joints that move straight from pose to pose."""
    places = _path_length(place)[0][: len(place)]
    slope, curvature = np.full(q.shape, np.nan), np.full(q.shape, np.nan)
    if places[-1] > 0.0:
        slope[:] = np.gradient(q, places, axis=0)
        curvature[:] = np.gradient(slope, places, axis=0)
    sense = _sense(np.diff(q, axis=0, prepend=q[:1]))
    return Motion(sense, slope, curvature, _since_reversal_by_steps(q, sense))


def _is_path(tip: Array) -> bool:
    """Whether poses (k, 3) follow a path; scattered points turn sharply at most."""
    step = np.diff(tip, axis=0)
    size = np.linalg.norm(step, axis=1)
    if len(tip) < LEAST or size.min() <= STILL * size.max():
        return False
    return bool(np.median(_turns(step)) <= CORNER)


def _turns(step: Array) -> Array:
    """Angle between each of the steps (k, 3) and the next, rad."""
    size = np.linalg.norm(step, axis=1)
    cosine = (step[1:] * step[:-1]).sum(axis=1) / (size[1:] * size[:-1])
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _breaks(tip: Array) -> tuple[Index, Index]:
    """Poses at which a path has a corner, and those to which a far step leads."""
    step = np.diff(tip, axis=0)
    size = np.linalg.norm(step, axis=1)
    far = np.flatnonzero(size > FAR * np.median(size)) + 1
    corners = np.flatnonzero(_turns(step) > CORNER) + 1
    return corners, far


def _lay_path(along: Motion, q: Array, place: Array, at: Index, rolling: bool) -> None:
    """Write what a smooth path through the poses `at` says of them into `along`.

    rolling  whether the path is entered rolling; else its first pose is a corner, which
             keeps what the path that led there says
    """
    if len(at) < LEAST:
        return
    length, closed = _path_length(place[at])
    places = length[: len(at)]
    around = np.vstack([q[at], q[at[:1]]]) if closed else q[at]
    ends = "periodic" if closed else "not-a-knot"
    path = scipy.interpolate.CubicSpline(length, around, bc_type=ends)
    approach = ARRIVAL * _steps_before(length, len(at))
    arriving = path(places) - path(places - approach)
    sense = _sense(arriving / approach[:, None])
    reversal = _since_reversal(path, length, places - approach / 2, closed)
    if not rolling:
        reversal = _since_corner(reversal, sense, q[at], along, int(at[0]))
    new = slice(0 if rolling else 1, None)
    along.rate[at[new]] = path(places, 1)[new]
    along.acceleration[at[new]] = path(places, 2)[new]
    along.sense[at[new]] = sense[new]
    along.reversal[at[new]] = reversal[new]


def _since_corner(
    reversal: Array, sense: Array, q: Array, along: Motion, corner: int
) -> Array:
    """Distances (k, nq) since a joint last turned, where that was at or before a corner.

    The corner is the first of the poses q (k, nq); `reversal` is infinite before a
    path's first turn.
    """
    gone = np.abs(q - q[:1])
    onward = sense == along.sense[corner]
    before = np.where(onward, along.reversal[corner] + gone, gone)
    return np.where(np.isinf(reversal), before, reversal)


def _path_length(place: Array) -> tuple[Array, bool]:
    """Length of path at k poses, and whether the run is closed.

    A closed run has k + 1 values: the last is the length back at the first pose.
    """
    steps = _distance(np.diff(place, axis=0))
    still = STILL * float(steps.max())
    steps = np.maximum(steps, still)
    last = float(_distance(place[:1] - place[-1:])[0])
    near = still < last < CLOSED * float(np.median(steps))
    closed = len(place) >= 2 * LEAST and near
    lengths = np.cumsum([*steps, last] if closed else steps)
    return np.concatenate([[0.0], lengths]), closed


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
    sign = pd.DataFrame(np.where(size > least, np.sign(moved), np.nan))
    return np.array(sign.ffill().bfill().fillna(0.0), dtype=float)


def _since_reversal(
    path: scipy.interpolate.CubicSpline,
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
