"""Vectorised NumPy written by hand for three machines: poses, and readings of one.

Newton's method over a twist of the platform, with exact slopes and all systems in one
call of `numpy.linalg.solve`. Rotations are matrices, updated by Rodrigues' formula. It
stops after a step below 1e-8, as this project does. The delta has a closed form.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pkm_models.machines import a3_head, hexapod

HEXAPOD_BASE = np.array(list(hexapod.B.values()))
HEXAPOD_PLATFORM = np.array(list(hexapod.A.values()))
ANGLES = np.array([a3_head.PHI[i] for i in a3_head.LIMBS])
DIRECTIONS = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0.0 * ANGLES], axis=1)
#: axes of the A3 head's revolute joints
AXES = np.stack([-np.sin(ANGLES), np.cos(ANGLES), 0.0 * ANGLES], axis=1)
A3_BASE = a3_head.B * DIRECTIONS
A3_PLATFORM = a3_head.A * DIRECTIONS - np.array([0.0, 0.0, a3_head.C])
STEP_TOLERANCE = 1e-8  #: step (m, rad) that ends Newton's method, as in this project
MAX_ITERATIONS = 30  #: most of its steps

#: residuals (n, 6) and slopes over the twist (n, 6, 6) at points and rotations
Equations = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
Poses = tuple[np.ndarray, np.ndarray]  #: points (n, 3) and rotations (n, 3, 3)


def turn(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) turned by rotation vectors (n, 3), by Rodrigues' formula."""
    angle = np.maximum(np.linalg.norm(vector, axis=1), 1e-150)[:, None, None]
    cross = np.zeros_like(rotation)
    cross[:, 0, 1], cross[:, 0, 2] = -vector[:, 2], vector[:, 1]
    cross[:, 1, 0], cross[:, 1, 2] = vector[:, 2], -vector[:, 0]
    cross[:, 2, 0], cross[:, 2, 1] = -vector[:, 1], vector[:, 0]
    square = cross @ cross
    change = np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle**2 * square
    return rotation + change @ rotation


def solve(equations: Equations, point: np.ndarray, rotation: np.ndarray) -> Poses:
    """Tool points and rotations where the equations hold."""
    for _ in range(MAX_ITERATIONS):
        residual, slopes = equations(point, rotation)
        step = -np.linalg.solve(slopes, residual[:, :, None])[:, :, 0]
        point, rotation = point + step[:, :3], turn(rotation, step[:, 3:])
        if np.abs(step).max() < STEP_TOLERANCE:
            break
    return point, rotation


def hexapod_poses(q: np.ndarray, p: np.ndarray, start: Poses) -> Poses:
    """Poses of the hexapod at joints (n, 6) and parameters (n, 42)."""
    count = len(q)
    base = HEXAPOD_BASE + p[:, :18].reshape(count, 6, 3)
    platform = HEXAPOD_PLATFORM + p[:, 18:36].reshape(count, 6, 3)
    length = q + p[:, 36:]

    def equations(point: np.ndarray, rotation: np.ndarray) -> Poses:
        arms = platform @ rotation.transpose(0, 2, 1)
        legs = point[:, None, :] + arms - base
        actual = np.sqrt(np.einsum("nik,nik->ni", legs, legs))
        unit = legs / actual[:, :, None]
        slopes = np.concatenate([unit, np.cross(arms, unit)], axis=2)
        return actual - length, slopes

    return solve(equations, *start)


def delta_poses(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Points of the delta at travels (n, 3) and parameters (n, 18): trilateration."""
    radius, arm, angle, endstop, lean, tip = p.reshape(len(p), 6, 3).transpose(1, 0, 2)
    cosine, sine = np.cos(angle), np.sin(angle)
    along = endstop + np.sqrt(arm * arm - radius * radius) - q
    along /= np.sqrt(lean * lean + tip * tip + 1.0)
    x = radius * cosine + along * (lean * cosine - tip * sine)
    y = radius * sine + along * (lean * sine + tip * cosine)
    centres = np.stack([x, y, along], axis=2)
    first = centres[:, 0]
    across, off = centres[:, 1] - first, centres[:, 2] - first
    distance = np.sqrt(np.einsum("ni,ni->n", across, across))
    e_x = across / distance[:, None]
    i = np.einsum("ni,ni->n", e_x, off)
    off = off - i[:, None] * e_x
    j = np.sqrt(np.einsum("ni,ni->n", off, off))
    e_y = off / j[:, None]
    squares = arm * arm
    u = (squares[:, 0] - squares[:, 1] + distance**2) / (2.0 * distance)
    v = (squares[:, 0] - squares[:, 2] + i * i + j * j - 2.0 * i * u) / (2.0 * j)
    below = np.sqrt(squares[:, 0] - u * u - v * v)
    e_z = np.cross(e_x, e_y)
    e_z *= -np.sign(e_z[:, 2:])
    return first + u[:, None] * e_x + v[:, None] * e_y + below[:, None] * e_z


def a3_poses(q: np.ndarray, p: np.ndarray, start: Poses) -> Poses:
    """Poses of the A3 head at joints (n, 3) and parameters (n, 24)."""
    count = len(q)
    length = q + p[:, :3]
    base = A3_BASE + p[:, 3:12].reshape(count, 3, 3)
    platform = A3_PLATFORM + p[:, 12:21].reshape(count, 3, 3)
    lean = length * np.sin(p[:, 21:])

    def equations(point: np.ndarray, rotation: np.ndarray) -> Poses:
        arms = platform @ rotation.transpose(0, 2, 1)
        limbs = point[:, None, :] + arms - base
        actual = np.sqrt(np.einsum("nik,nik->ni", limbs, limbs))
        unit = limbs / actual[:, :, None]
        across = np.einsum("nik,ik->ni", limbs, AXES) - lean
        normals = np.concatenate([unit, np.broadcast_to(AXES, unit.shape)], axis=1)
        arms = np.concatenate([arms, arms], axis=1)
        slopes = np.concatenate([normals, np.cross(arms, normals)], axis=2)
        return np.concatenate([actual - length, across], axis=1), slopes

    return solve(equations, *start)


def a3_readings(q: np.ndarray, theta: np.ndarray, start: Poses) -> np.ndarray:
    """Ball-bar lengths (m, n - 1) at theta (m, 27).

    q      (n, 3) joints of the readings, the taught cup's last
    start  poses of the n joints
    """
    m, n = len(theta), len(q)
    all_q, all_p = np.tile(q, (m, 1)), np.repeat(theta[:, :24], n, axis=0)
    first = np.tile(start[0], (m, 1)), np.tile(start[1], (m, 1, 1))
    points = a3_poses(all_q, all_p, first)[0].reshape(m, n, 3)
    bars = points[:, :-1] - points[:, -1:] - theta[:, None, 24:]
    return np.sqrt(np.einsum("mnk,mnk->mn", bars, bars))
