"""How the joints move along each run: rate, acceleration, sense, and how far each has
gone since it last turned back.

A run is a smooth path through its poses, closed where it ends as near to its start as
one pose is to the next; a closed one is entered rolling. Between two readings a joint
may turn back: where it does is told by the path, not by the steps.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from oed.arrays import Array, Index

#: poses of a run from which on a path is laid through them
LEAST = 4
#: turn of the tool's way at the poses, in the middle of a run's, beyond which poses are
#: points and no path, rad
CORNER = np.deg2rad(50.0)
#: distance from end to start of a closed run, in steps between its poses
CLOSED = 1.5


@dataclasses.dataclass(frozen=True, slots=True)
class Motion:
    """sense, rate, acceleration, reversal (m, nq) as in `State`; rates are NaN where
    the feed is not known.
    """

    sense: Array
    rate: Array
    acceleration: Array
    reversal: Array


def motion(
    q: Array, tip: Array, run: NDArray[np.str_], order: Array, feed: Array, still: Index
) -> Motion:
    """Motion of joints q (m, nq) with the tool at tip (m, 3), from the order of poses
    in each run and its feed; poses `still` are stood at.
    """
    sense, reversal = np.zeros(q.shape), np.zeros(q.shape)
    rate, acceleration = np.full(q.shape, np.nan), np.full(q.shape, np.nan)
    rate[still] = acceleration[still] = 0.0
    moving = np.setdiff1d(np.arange(len(q)), still)
    for label in dict.fromkeys(run[moving]):
        at = moving[run[moving] == label]
        at = at[np.argsort(order[at], kind="stable")]
        if len(at) < 2:
            rate[at] = acceleration[at] = 0.0
            continue
        way, closed = _way(tip[at])
        path = _path(q[at], tip[at], way, closed)
        if path is None:
            slope = np.gradient(q[at], way[: len(at)], axis=0)
            bend = np.gradient(slope, way[: len(at)], axis=0)
            sense[at] = _sense(slope)
            reversal[at] = _stepped(q[at], sense[at])
        else:
            slope, bend = path(way[: len(at)], 1), path(way[: len(at)], 2)
            sense[at] = _sense(slope)
            reversal[at] = _since(path, way, len(at), closed)
        rate[at], acceleration[at] = slope * feed[at, None], bend * feed[at, None] ** 2
    return Motion(sense, rate, acceleration, reversal)


def _way(tip: Array) -> tuple[Array, bool]:
    """Length of path at k poses, and back at the first where the run is closed (then k
    + 1 values).
    """
    steps = np.maximum(np.linalg.norm(np.diff(tip, axis=0), axis=1), 1e-9)
    last = float(np.linalg.norm(tip[0] - tip[-1]))
    closed = len(tip) >= 2 * LEAST and 1e-6 < last < CLOSED * float(np.median(steps))
    return (
        np.concatenate([[0.0], np.cumsum([*steps, last] if closed else steps)]),
        closed,
    )


def _path(q: Array, tip: Array, way: Array, closed: bool) -> CubicSpline | None:
    """Joints over the length of path; None where the poses are too few, or points to be
    reached in any order.
    """
    step = np.diff(tip, axis=0)
    size = np.linalg.norm(step, axis=1)
    if len(q) < LEAST or size.min() < 1e-6:
        return None
    turn = np.arccos(
        np.clip((step[1:] * step[:-1]).sum(axis=1) / (size[1:] * size[:-1]), -1.0, 1.0)
    )
    if np.median(turn) > CORNER:
        return None
    return (
        CubicSpline(way, np.vstack([q, q[:1]]), bc_type="periodic")
        if closed
        else CubicSpline(way, q)
    )


def _sense(slope: Array) -> Array:
    """Sign of each joint's motion (k, nq) at its poses, kept where it stands still."""
    size = np.abs(slope)
    sign = np.where(size > 1e-6 * max(float(size.max()), 1e-12), np.sign(slope), 0.0)
    for k in range(1, len(sign)):
        sign[k] = np.where(sign[k] == 0.0, sign[k - 1], sign[k])
    for k in range(len(sign) - 2, -1, -1):
        sign[k] = np.where(sign[k] == 0.0, sign[k + 1], sign[k])
    return sign


def _since(path: CubicSpline, way: Array, count: int, closed: bool) -> Array:
    """Distance (count, nq) gone since the path last turned back; before an open run's
    first turn, far away.
    """
    places = way[:count]
    q = path(places)
    gone = np.full(q.shape, np.inf)
    for joint, found in enumerate(path.derivative().roots(extrapolate=False)):
        turns = np.unique(found[np.isfinite(found)])
        if closed and turns.size:
            turns = np.concatenate([[turns[-1] - way[-1]], turns])
        last = np.searchsorted(turns, places, side="right") - 1
        some = last >= 0
        gone[some, joint] = np.abs(q[some, joint] - path(turns[last[some]])[:, joint])
    return gone


def _stepped(q: Array, sense: Array) -> Array:
    """Distance (k, nq) gone since the last change of sense, by steps; a run's start
    counts as none, far away.
    """
    step = np.abs(np.diff(q, axis=0, prepend=q[:1]))
    gone = np.full(q.shape, np.inf)
    for k in range(1, len(q)):
        gone[k] = np.where(sense[k] == sense[k - 1], gone[k - 1] + step[k], step[k])
    return gone
