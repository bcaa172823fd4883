"""Planar manipulator: two sliders, two struts."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.generator.machine import Array, Machine, Pose

_PD, _PL = 3.584, 3.350  # m, Chang, Li and Li 2011
_SIDE = np.array([-0.5, 0.5])
_PLANAR_TOLERANCE = np.array([0.5e-3, 0.5e-3, 0.5e-3, 0.5e-3, 0.5e-3, 0.3e-3, 0.3e-3])


def _planar_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    travel, tilt = q + p[:, 1:3], p[:, 5:7]
    y = _SIDE * p[:, 0:1] - travel * np.sin(tilt) + p[:, 7:9]
    z = travel * np.cos(tilt)
    return np.sqrt((x[:, 0:1] - y) ** 2 + (x[:, 1:2] - z) ** 2) - p[:, 3:5]


def _planar_inverse(command: Array, tool: Array) -> Pose:
    q = command[:, 1:] + np.sqrt(_PL**2 - (command[:, :1] - _SIDE * _PD) ** 2)
    return Pose(command.copy(), np.tile(np.eye(3), (len(command), 1, 1)), q)


def _planar_growth(spread: Array) -> Array:
    dp = np.zeros(9)
    dp[0], dp[7:9] = _PD, _SIDE * _PD * (spread - 1.0)
    return dp


PLANAR = Machine(
    name="planar",
    command=(("y", "mm"), ("z", "mm")),
    legs=2,
    parameters=("D", "z1", "z2", "l1", "l2", "beta1", "beta2"),
    nominal=np.array([_PD, 0.0, 0.0, _PL, _PL, 0.0, 0.0]),
    tolerance=_PLANAR_TOLERANCE,
    extras=("side1", "side2"),
    closure=_planar_closure,
    inverse=_planar_inverse,
    turns=False,
    weight=1500.0,
    com=0.0,
    growth=_planar_growth,
)


def leg_vectors(pose: Pose) -> Array:
    """Legs (n, 2, 3) of the nominal machine, carriage to platform, m."""
    side = np.broadcast_to(_SIDE * _PD, pose.q.shape)
    foot = np.stack([0 * pose.q, side, pose.q], -1)
    point = np.stack([0 * pose.x[:, 0], pose.x[:, 0], pose.x[:, 1]], -1)
    return point[:, None] - foot
