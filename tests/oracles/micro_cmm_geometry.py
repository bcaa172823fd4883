"""Oracle for the micro-CMM (Rugbani and Schreve), m and rad; it must never import the
toolkit.

Squared leg lengths and their differences, linear in x and y, against the toolkit's
Newton on the lengths themselves. Leading shapes broadcast; complex input passes
through, for complex-step derivatives. `printed` is Eqs. (6)-(8) of the paper to the
letter.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

THETA = np.deg2rad([0.0, 120.0, 240.0])


def centres(
    rf: ArrayLike, rp: ArrayLike, thetaf: ArrayLike, thetap: ArrayLike
) -> NDArray:
    """Sphere centres f_i - p_i in the plane, (..., leg, 2), from radii and angles (...,
    3): Eqs. (1)-(2).
    """
    rf, rp, tf, tp = (np.asarray(v) for v in (rf, rp, thetaf, thetap))
    return np.stack(
        [rf * np.cos(tf) - rp * np.cos(tp), rf * np.sin(tf) - rp * np.sin(tp)], -1
    )


def probe(lengths: ArrayLike, centre: ArrayLike) -> NDArray:
    """Probe (..., 3) below the frame at leg lengths (..., 3): 2 (c_i - c_1) (x, y) =
    l_1^2 - l_i^2 + c_i^2 - c_1^2.
    """
    square, c = np.asarray(lengths) ** 2, np.asarray(centre)
    matrix = 2.0 * (c[..., 1:, :] - c[..., :1, :])
    norm = (c * c).sum(-1)
    right = square[..., :1] - square[..., 1:] + norm[..., 1:] - norm[..., :1]
    shape = np.broadcast_shapes(matrix.shape[:-2], right.shape[:-1])
    xy = np.linalg.solve(
        np.broadcast_to(matrix, (*shape, 2, 2)),
        np.broadcast_to(right, (*shape, 2))[..., None],
    )[..., 0]
    away = xy - c[..., 0, :]
    return np.concatenate(
        [xy, -np.sqrt(square[..., :1] - (away * away).sum(-1, keepdims=True))], -1
    )


def legs(point: ArrayLike, centre: ArrayLike) -> NDArray:
    """Leg lengths (..., 3) at a probe (..., 3): Eqs. (3)-(5)."""
    p, c = np.asarray(point), np.asarray(centre)
    away = p[..., None, :2] - c
    return np.sqrt((away * away).sum(-1) + p[..., None, 2] ** 2)


def printed(lengths: ArrayLike, rho: float) -> NDArray:
    """Eqs. (6), (7), (8) as printed, (..., 3); cos theta_2^2 read as the square of the cosine."""
    l1, l2, l3 = np.moveaxis(np.asarray(lengths), -1, 0)
    cos, sin = np.cos(THETA), np.sin(THETA)
    x = (2 * l1**2 + l2**2 + l3**2) / (4 * rho * (cos[0] - cos[1]))
    x = x - rho * (cos[1] ** 2 - 1) / (2 * (cos[0] - cos[1]))
    y = (l2**2 - l3**2) / (2 * rho * (sin[1] - sin[2])) - rho * (
        sin[1] ** 2 - sin[2] ** 2
    ) / (2 * (sin[1] - sin[2]))
    return np.stack([x, y, printed_z(x, y, l2, rho)], -1)


def printed_z(x: NDArray, y: NDArray, l2: NDArray, rho: float) -> NDArray:
    """Eq. (8) at given x and y; complex where its radicand is negative."""
    radicand = (
        l2**2 - (x + rho * np.cos(THETA[1])) ** 2 - (y + rho * np.sin(THETA[1])) ** 2
    )
    return np.sqrt(np.asarray(radicand, dtype=complex))
