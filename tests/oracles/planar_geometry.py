"""Oracle for the planar manipulator with two struts (Chang, Li and Li 2011, Chin. J.
Mech. Eng.), SI units (m, rad).

The forward solver is the lower intersection of two circles in closed form, the rows are
Eqs. (10)-(11) of the paper written out: no closure, no Newton, no automatic derivative.
It must never import the toolkit.

A machine is p (..., 7) = D, z1, z2, l1, l2, beta1, beta2, with z_i the home errors of
the sliders; poses are (..., 2) = y, z. All leading shapes broadcast; complex input
passes through `forward`, for complex-step derivatives.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

D, L = 3.584, 3.350  # m, section 2.2
NOMINAL = np.array([D, 0.0, 0.0, L, L, 0.0, 0.0])
Y = np.arange(-5, 6) * 0.3  #: section 2.3.3: lines and places on them, m
Z = np.arange(6) * 0.3
LEVELS = (0.0, 0.750, 1.500)
SIDES = (-1.500, 0.0, 1.500)


def sliders(q: ArrayLike, p: ArrayLike) -> NDArray:
    """Slider joints (..., limb, yz) from scale readings q (..., 2)."""
    q, p = np.asarray(q), np.asarray(p)
    travel, tilt = q + p[..., 1:3], p[..., 5:7]
    foot = np.stack([-p[..., 0] / 2, p[..., 0] / 2], -1)
    return np.stack([foot - travel * np.sin(tilt), travel * np.cos(tilt)], -1)


def forward(q: ArrayLike, p: ArrayLike) -> NDArray:
    """Platform (..., 2): the point below the sliders at distances l1 and l2 from them."""
    p, s = np.asarray(p), sliders(q, p)
    l1, l2 = p[..., 3], p[..., 4]
    v = s[..., 1, :] - s[..., 0, :]
    d2 = (v * v).sum(-1)
    along = (l1**2 - l2**2 + d2) / (2 * d2)
    across = np.sqrt(l1**2 / d2 - along**2)
    # v turned clockwise: it points down while slider 2 is on the right
    down = np.stack([v[..., 1], -v[..., 0]], -1)
    return s[..., 0, :] + along[..., None] * v + across[..., None] * down


def inverse(pose: ArrayLike, p: ArrayLike = NOMINAL) -> NDArray:
    """Scale readings q (..., 2) that put a machine with upright guides at pose (..., 2)."""
    pose, p = np.asarray(pose), np.asarray(p)
    foot = np.stack([-p[..., 0] / 2, p[..., 0] / 2], -1)
    return (
        pose[..., 1:]
        + np.sqrt(p[..., 3:5] ** 2 - (pose[..., :1] - foot) ** 2)
        - p[..., 1:3]
    )


def rows(pose: ArrayLike) -> NDArray:
    """J (..., 2, 7) of Eqs. (10)-(12) at the nominal machine: d(y, z)/dp at fixed scale
    readings.
    """
    pose = np.asarray(pose)
    height = inverse(pose)
    foot = np.array([-D / 2, D / 2])
    # (..., limb, yz), slider to platform
    n = np.stack([pose[..., :1] - foot, pose[..., 1:] - height], -1) / L
    right = np.zeros((*pose.shape[:-1], 2, 7))
    for i, half in enumerate((-0.5, 0.5)):
        right[..., i, 0] = half * n[..., i, 0]
        right[..., i, 1 + i] = n[..., i, 1]
        right[..., i, 3 + i] = 1.0
        # n^T W e z_i with W e = (-1, 0)
        right[..., i, 5 + i] = -n[..., i, 0] * height[..., i]
    return np.linalg.solve(n, right)


def lines(measurement: int) -> tuple[NDArray, NDArray]:
    """Poses (n, 2) of RM 1 to 5 as in section 2.3.3, reference first on each line, and
    the line (n,) of each.
    """
    found, label = [], []
    if measurement in (2, 4):
        for k, y in enumerate(SIDES):
            found += [(y, z) for z in Z]
            label += [k] * len(Z)
    else:
        for k, z in enumerate(LEVELS):
            found += [(0.0, z), *((y, z) for y in Y if abs(y) > 1e-9)]
            label += [k] * len(Y)
    return np.array(found), np.array(label)


def relative(values: ArrayLike, line: ArrayLike) -> NDArray:
    """Values (n, ...) less that of the first pose of their line, which is left out: Eq. (13)."""
    values, line = np.asarray(values), np.asarray(line)
    first = np.array([int(np.flatnonzero(line == k)[0]) for k in line])
    return (values - values[first])[first != np.arange(len(line))]


def identification_rows(measurement: int) -> NDArray:
    """Aggregated relative identification matrix (readings, 7) of RM 1 to 5; RM 5: dy
    and dz alternate.
    """
    pose, line = lines(measurement)
    j = relative(rows(pose), line)
    channel = {1: [0], 2: [1], 3: [1], 4: [0], 5: [0, 1]}[measurement]
    return j[:, channel].reshape(-1, 7)
