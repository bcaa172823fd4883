"""Oracle for a hexapod (6-UPS), m and rad; it must never import the toolkit.

The forward solver knows no orientation: its unknowns are the nine coordinates of
platform joints 1, 3 and 5, its equations their three mutual distances and the six
squared leg lengths, all polynomials. The other joints follow in the frame that the
three carry. Rotations are told as matrices, and compared by the motion of points.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

CARRIERS = (0, 2, 4)
PAIRS = ((0, 1), (1, 2), (2, 0))


def _edges(carriers: NDArray) -> NDArray:
    """Two edges and their cross product, in columns (3, 3), of three points (3, 3), one a row."""
    u, v = carriers[1] - carriers[0], carriers[2] - carriers[0]
    cross = np.array(
        [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ]
    )
    return np.stack([u, v, cross], -1)


def forward(
    lengths: ArrayLike, base: ArrayLike, local: ArrayLike, start: ArrayLike
) -> tuple[NDArray, NDArray]:
    """Tool point (3,) and rotation (3, 3) at leg lengths (6,), for joints base, local
    (6, 3).

    start (6, 3): places of the platform joints near the solution.
    """
    base, local, lengths = (np.asarray(v, dtype=float) for v in (base, local, lengths))
    weight = np.linalg.solve(
        _edges(local[list(CARRIERS)]), (local - local[0]).T
    ).T  # joints in the carriers' frame
    sides = np.array(
        [((local[CARRIERS[a]] - local[CARRIERS[b]]) ** 2).sum() for a, b in PAIRS]
    )

    def equations(unknown: NDArray) -> NDArray:
        carriers = unknown.reshape(3, 3)
        joints = carriers[0] + weight @ _edges(carriers).T
        away = joints - base
        rigid = np.array([((carriers[a] - carriers[b]) ** 2).sum() for a, b in PAIRS])
        return np.concatenate([rigid - sides, (away * away).sum(-1) - lengths**2])

    unknown = np.asarray(start, dtype=float)[list(CARRIERS)].ravel()
    for _ in range(50):
        slope = np.stack(
            [equations(unknown + 1e-30j * e).imag / 1e-30 for e in np.eye(9)], -1
        )
        step = np.linalg.solve(slope, equations(unknown))
        unknown = unknown - step
        if np.abs(step).max() < 1e-15:
            break
    carriers = unknown.reshape(3, 3)
    rotation = _edges(carriers) @ np.linalg.inv(_edges(local[list(CARRIERS)]))
    return carriers[0] - rotation @ local[0], rotation


def legs(
    point: ArrayLike, rotation: ArrayLike, base: ArrayLike, local: ArrayLike
) -> NDArray:
    """Leg lengths (6,) at a pose."""
    away = (
        np.asarray(point)
        + np.asarray(local) @ np.asarray(rotation).T
        - np.asarray(base)
    )
    return np.sqrt((away * away).sum(-1))
