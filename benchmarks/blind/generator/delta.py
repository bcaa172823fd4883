"""Linear delta: three vertical sliders, three arms."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.generator.machine import Array, Machine, Pose

_DR, _DL, _DE = 0.16175, 0.345, 0.420  # m, FLSun V400
_DA = np.deg2rad([210.0, 330.0, 90.0])
_DELTA_NAMES = (
    "radius",
    "arm1",
    "arm2",
    "arm3",
    "angle1",
    "angle2",
    "angle3",
    "endstop1",
    "endstop2",
    "endstop3",
)


def _delta_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    radius, arm, angle = p[:, 0:1], p[:, 1:4], p[:, 4:7]
    height = p[:, 7:10] + np.sqrt(arm**2 - radius**2) - q
    outward, sideways = radius + p[:, 10:13], p[:, 13:16]
    cx = outward * np.cos(angle) - sideways * np.sin(angle)
    cy = outward * np.sin(angle) + sideways * np.cos(angle)
    return (
        np.sqrt(
            (x[:, 0:1] - cx) ** 2 + (x[:, 1:2] - cy) ** 2 + (x[:, 2:3] - height) ** 2
        )
        - arm
    )


def _delta_inverse(command: Array, tool: Array) -> Pose:
    flat = (command[:, :1] - _DR * np.cos(_DA)) ** 2 + (
        command[:, 1:2] - _DR * np.sin(_DA)
    ) ** 2
    q = _DE + np.sqrt(_DL**2 - _DR**2) - command[:, 2:] - np.sqrt(_DL**2 - flat)
    return Pose(command.copy(), np.tile(np.eye(3), (len(command), 1, 1)), q)


def _delta_growth(spread: Array) -> Array:
    dp = np.zeros(16)
    dp[0], dp[10:13] = _DR, _DR * (spread - 1.0)
    return dp


DELTA = Machine(
    name="delta",
    command=(("x", "mm"), ("y", "mm"), ("z", "mm")),
    legs=3,
    parameters=_DELTA_NAMES,
    nominal=np.array([_DR, _DL, _DL, _DL, *_DA, _DE, _DE, _DE]),
    tolerance=np.array(
        [0.5e-3, 1e-3, 1e-3, 1e-3, 3.5e-3, 3.5e-3, 0.0, 1.5e-3, 1.5e-3, 1.5e-3]
    ),
    extras=("out1", "out2", "out3", "side1", "side2", "side3"),
    closure=_delta_closure,
    inverse=_delta_inverse,
    turns=False,
    weight=8.0,
    com=0.0,
    growth=_delta_growth,
)


def leg_vectors(pose: Pose) -> Array:
    """Legs (n, 3, 3) of the nominal machine, carriage to platform, m."""
    circle = _DR * np.stack([np.cos(_DA), np.sin(_DA)], -1)
    ring = np.broadcast_to(circle, (len(pose.q), 3, 2))
    height = _DE + np.sqrt(_DL**2 - _DR**2) - pose.q
    return pose.x[:, None, :] - np.concatenate([ring, height[:, :, None]], -1)
