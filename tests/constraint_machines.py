"""A micro-CMM and a hexapod for sensors on passive joints and constraints, written anew:
readings, and their slopes by central differences; m and rad.

`oracles.micro_cmm_geometry` solves the micro-CMM's Eqs. (3)-(5) of Rugbani and Schreve in
closed form; the angles of its legs and the hexapod's legs are written here. Of the
toolkit there are the numbers of the drawings alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from oracles import micro_cmm_geometry as oracle
from scipy.spatial.transform import Rotation

from pkm_models.machines import hexapod, micro_cmm

CMM = micro_cmm.machine
LEGS = np.arange(3)
GRID = np.array(
    list(
        itertools.product([-0.035, 0, 0.035], [-0.035, 0, 0.035], [-0.24, -0.2, -0.16])
    )
)


# -- the micro-CMM by itself -------------------------------------------------------------


def centres(p: np.ndarray) -> np.ndarray:
    """f_i - p_i (leg, 2) of parameters (15,)."""
    return oracle.centres(p[:3], p[3:6], p[6:9], p[9:12])


def lengths(points: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Recorded leg lengths (n, 3) at probes (n, 3)."""
    return oracle.legs(points, centres(p)) - p[12:]


def probes(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Probes (n, 3) at recorded leg lengths (n, 3)."""
    return oracle.probe(q + p[12:], centres(p))


def angles(points: np.ndarray, p: np.ndarray) -> np.ndarray:
    """swing1, side1, swing2, ... (n, 6) of the legs at their frame joints.

    The swing is 0 for a leg that hangs straight down and grows towards the axis.
    """
    columns = []
    for i, (cx, cy) in enumerate(centres(p)):
        x, y = points[:, 0] - cx, points[:, 1] - cy
        out = x * np.cos(p[6 + i]) + y * np.sin(p[6 + i])
        across = y * np.cos(p[6 + i]) - x * np.sin(p[6 + i])
        length = np.sqrt(x**2 + y**2 + points[:, 2] ** 2)
        columns += [np.arctan2(-out, -points[:, 2]), np.arcsin(across / length)]
    return np.column_stack(columns)


def locked_poses(leg: int) -> np.ndarray:
    """Probes (n, 3) of the perfect machine at which a leg swings as it does at home.

    The leg leans inwards by 140 mm on 200 mm of height.
    """
    poses = []
    for a, z in itertools.product([-0.02, 0.0, 0.02], [-0.22, -0.2, -0.18]):
        radial = 0.14 + 0.7 * z  # along the leg's own radius
        turn = 2.0 * np.pi * leg / 3.0
        poses.append(
            [
                radial * np.cos(turn) - a * np.sin(turn),
                radial * np.sin(turn) + a * np.cos(turn),
                z,
            ]
        )
    return np.array(poses)


def slopes(read: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> np.ndarray:
    """Central differences (N, n) of a function's values."""
    columns = []
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = 1e-6
        columns.append((read(at + step) - read(at - step)).ravel() / 2e-6)
    return np.column_stack(columns)


def rank_of(rows: np.ndarray, scale: np.ndarray) -> int:
    """Rank of slopes with their columns as lengths; it must be clear."""
    values = np.linalg.svd(rows * scale, compute_uv=False)
    rank = int((values > 1e-6 * values[0]).sum())
    clear = values[rank:].max(initial=0.0) < 1e-8 * values[0]
    assert clear
    assert values[rank - 1] > 1e-4 * values[0]
    return rank


def external_slopes() -> np.ndarray:
    q = lengths(GRID, CMM.nominal)
    return slopes(lambda p: probes(q, p), CMM.nominal)


def sensor_slopes() -> np.ndarray:
    """Over 15 parameters, and zero and scale of each of six sensors."""
    q = lengths(GRID, CMM.nominal)
    home = angles(np.array([[0.0, 0.0, -0.2]]), CMM.nominal)[0]

    def read(theta: np.ndarray) -> np.ndarray:
        theta_k = angles(probes(q, theta[:15]), theta[:15])
        return theta_k + theta[15::2] + theta[16::2] * (theta_k - home)

    return 0.2 * slopes(read, np.r_[CMM.nominal, np.zeros(12)])


def plate_slopes() -> np.ndarray:
    """Over 15 parameters, and offset and two tilts of each of three plates."""

    def read(theta: np.ndarray) -> np.ndarray:
        rows = []
        for k, height in enumerate((-0.24, -0.2, -0.16)):
            points = GRID[GRID[:, 2] == height]
            q = lengths(points, CMM.nominal)
            x, y, z = probes(q, theta[:15]).T
            offset, tilt_x, tilt_y = theta[15 + 3 * k : 18 + 3 * k]
            # a plane turned about x, then about y
            rows.append(z - height - offset - np.tan(tilt_x) * y + np.tan(tilt_y) * x)
        return np.concatenate(rows)

    return slopes(read, np.r_[CMM.nominal, np.zeros(9)])


def lock_slopes() -> np.ndarray:
    """Over 15 parameters, and where each of three legs is locked."""

    def read(theta: np.ndarray) -> np.ndarray:
        rows = []
        for leg in LEGS:
            q = lengths(locked_poses(leg), CMM.nominal)
            swing = angles(probes(q, theta[:15]), theta[:15])[:, 2 * leg]
            rows.append(swing - theta[15 + leg])
        return np.concatenate(rows)

    return 0.2 * slopes(read, np.r_[CMM.nominal, np.zeros(3)])


CMM_SCALE = np.r_[np.ones(6), np.full(6, 5.0), np.ones(3)]
SETUP_SCALE = {
    "external": [],
    "sensors": [5.0] * 12,
    "plates": [1.0, 5.0, 5.0] * 3,
    "locks": [5.0] * 3,
}
OWN_SLOPES = {
    "external": external_slopes,
    "sensors": sensor_slopes,
    "plates": plate_slopes,
    "locks": lock_slopes,
}


# -- the hexapod in a seat -----------------------------------------------------------------

BASE = np.array([hexapod.B[i] for i in range(1, 7)])
PLATFORM = np.array([hexapod.A[i] for i in range(1, 7)])
SEAT = np.array([0.0, 0.0, 0.5])


def hexapod_lengths(
    point: np.ndarray, turns: Rotation, p: np.ndarray | None = None
) -> np.ndarray:
    """Recorded leg lengths (n, 6) with the tool point at (n, 3)."""
    p = np.zeros(42) if p is None else p
    feet, joints = BASE + p[:18].reshape(6, 3), PLATFORM + p[18:36].reshape(6, 3)
    ends = point[:, None] + np.einsum("nij,kj->nki", turns.as_matrix(), joints)
    return np.linalg.norm(ends - feet, axis=2) - p[36:]


def swing1(point: np.ndarray, rotation: np.ndarray) -> float:
    """Angle of the first of some poses' leg 1 from z, outward, in its joint's plane."""
    leg = point[0] + rotation[0] @ PLATFORM[0] - BASE[0]
    outward = BASE[0] / np.linalg.norm(BASE[0])
    return float(np.arctan2(leg @ outward, leg[2]))


def turned(rng: np.random.Generator, n: int) -> Rotation:
    return Rotation.from_rotvec(rng.uniform(-0.25, 0.25, (n, 3)))


def seat_slopes(turns: Rotation) -> np.ndarray:
    """Over 42 parameters and the seat: - (d length / d pose)^-1 d length / d p."""
    rows = []
    for k in range(len(turns)):
        turn = turns[k : k + 1]

        def by_pose(twist: np.ndarray, turn: Rotation = turn) -> np.ndarray:
            moved = Rotation.from_rotvec(twist[3:]) * turn
            return hexapod_lengths(SEAT + twist[None, :3], moved)

        def by_parameter(p: np.ndarray, turn: Rotation = turn) -> np.ndarray:
            return hexapod_lengths(SEAT[None], turn, p)

        moves = -np.linalg.solve(
            slopes(by_pose, np.zeros(6)), slopes(by_parameter, np.zeros(42))
        )
        rows.append(np.hstack([moves[:3], -np.eye(3)]))
    return np.vstack(rows)
