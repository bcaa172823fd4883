"""Phase of each pose along its run: an angle about a loop, or the way along a line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oed.base.arrays import Array, Index

#: share of a run's longest extent that the second must have for it to be a loop rather
#: than a line
LOOP = 0.2
#: share of its distance from the base's origin by which a tool that stays in its place
#: moves by rounding, and an angle that is none, rad
ROUNDING = 1e-9


def phase_along_runs(tip: Array, run: NDArray[np.str_], taught: Index) -> Array:
    """Phase (m,) of each pose along its run, rad.

    It is 0 at the poses `taught` and in runs too short to have one.
    """
    phase = np.zeros(len(tip))
    moving = np.setdiff1d(np.arange(len(tip)), taught)
    for label in dict.fromkeys(run[moving]):
        at = moving[run[moving] == label]
        offset = tip[at] - tip[at].mean(axis=0)
        _, extent, axes = np.linalg.svd(offset, full_matrices=False)
        if len(at) < 3 or extent[0] <= ROUNDING * np.linalg.norm(tip[at]):
            continue
        if extent[1] > LOOP * extent[0]:
            phase[at] = _angle(offset, axes)
        else:
            phase[at] = _share_of_line(offset @ _oriented(axes[0]))
    return phase


def _oriented(axis: Array) -> Array:
    """An axis (3,) with its largest component positive."""
    largest = np.argmax(np.abs(axis))
    return np.asarray(axis * np.sign(axis[largest]))


def _share_of_line(along: Array) -> Array:
    """Way (k,) along a line as an angle in [0, 2 pi)."""
    length = np.ptp(along) * (1.0 + 1e-9)
    return np.asarray(2.0 * np.pi * (along - along.min()) / length)


def _angle(offset: Array, axes: Array) -> Array:
    """Angle (k,) in [0, 2 pi) about the normal of a loop's plane.

    It starts at the base's x axis, or at y where the normal is near x.
    """
    normal = _oriented(axes[2])
    start = np.eye(3)[1 if abs(normal[0]) >= 0.9 else 0]
    first = start - normal * (start @ normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.mod(np.arctan2(offset @ second, offset @ first), 2.0 * np.pi)
    # a circle that begins at 0 would end in either place by rounding
    return np.where(angle > 2.0 * np.pi - ROUNDING, 0.0, angle)
