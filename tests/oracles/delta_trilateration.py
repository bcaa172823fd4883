"""Oracle for a linear delta: closed-form trilateration of three spheres
(data/delta_v400/SOURCE.txt).

Any one length unit (the real data are in mm); angles in rad. Tower i stands at R (cos
a_i, sin a_i), its carriage at height endstop_i + sqrt(arm_i^2 - R^2) - travel_i, where
travel_i = steps_i * step_distance_i; the nozzle is the lower point at distance arm_i
from each carriage. All leading shapes broadcast; complex input passes through, for
complex-step derivatives. It must never import the toolkit.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def carriages(
    travel: ArrayLike,
    radius: ArrayLike,
    arm: ArrayLike,
    angle: ArrayLike,
    endstop: ArrayLike,
) -> NDArray:
    """Sphere centres (..., tower, xyz) from travel, arm, angle, endstop (..., 3) and
    radius (...).
    """
    r = np.asarray(radius)[..., None]
    height = (
        np.asarray(endstop) + np.sqrt(np.asarray(arm) ** 2 - r**2) - np.asarray(travel)
    )
    xy = (r * np.cos(angle), r * np.sin(angle))
    return np.stack(np.broadcast_arrays(*xy, height), -1)


def lower_point(centres: ArrayLike, radii: ArrayLike) -> NDArray:
    """Lower intersection (..., 3) of spheres with centres (..., 3, 3), one a row, and
    radii (..., 3).
    """
    c, r = np.asarray(centres), np.asarray(radii)
    u, v = c[..., 1, :] - c[..., 0, :], c[..., 2, :] - c[..., 0, :]
    d = np.sqrt((u * u).sum(-1))
    ex = u / d[..., None]
    i = (ex * v).sum(-1)
    w = v - i[..., None] * ex
    j = np.sqrt((w * w).sum(-1))
    ey = w / j[..., None]
    ez = np.cross(ex, ey)
    ez = ez * -np.sign(ez[..., 2:].real)  # downwards
    x = (r[..., 0] ** 2 - r[..., 1] ** 2 + d**2) / (2 * d)
    y = (r[..., 0] ** 2 - r[..., 2] ** 2 + i**2 + j**2 - 2 * i * x) / (2 * j)
    h2 = r[..., 0] ** 2 - x**2 - y**2
    if (h2.real < 0).any():
        raise ArithmeticError("lower_point: the spheres do not meet")
    return (
        c[..., 0, :]
        + x[..., None] * ex
        + y[..., None] * ey
        + np.sqrt(h2)[..., None] * ez
    )


def nozzle(
    travel: ArrayLike,
    radius: ArrayLike,
    arm: ArrayLike,
    angle: ArrayLike,
    endstop: ArrayLike,
) -> NDArray:
    """Nozzle (..., 3): forward kinematics of SOURCE.txt; arguments as for `carriages`."""
    return lower_point(carriages(travel, radius, arm, angle, endstop), arm)


def travel_to(
    point: ArrayLike,
    radius: ArrayLike,
    arm: ArrayLike,
    angle: ArrayLike,
    endstop: ArrayLike,
) -> NDArray:
    """Carriage travel (..., 3), downwards from the endstops, that puts the nozzle at
    point (..., 3).
    """
    p, arm = np.asarray(point), np.asarray(arm)
    top = carriages(np.zeros(3), radius, arm, angle, endstop)
    flat2 = ((top[..., :2] - p[..., None, :2]) ** 2).sum(-1)
    return top[..., 2] - p[..., 2:] - np.sqrt(arm**2 - flat2)
