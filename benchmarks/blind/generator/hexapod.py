"""Hexapod: six extensible struts."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.generator.machine import (
    XYZ,
    Array,
    Machine,
    Pose,
    about,
    cayley,
    growth_points,
    norm,
    points,
)


def _ring(radius: float, half: float, height: float) -> Array:
    angle = np.deg2rad(
        [120.0 * (i // 2) + (half if i % 2 else -half) for i in range(6)]
    )
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(6, height)], -1
    )


_HEX_BASE, _HEX_LOCAL = _ring(0.300, 15.0, 0.0), _ring(0.200, 45.0, 0.100)


def _hex_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    R = R0 @ cayley(x[:, 3:6])
    joint = x[:, None, :3] + points(p, 18, _HEX_LOCAL) @ np.swapaxes(R, 1, 2)
    return norm(joint - points(p, 0, _HEX_BASE)) - q - p[:, 36:42]


def hexapod_inverse(command: Array, tool: Array) -> Pose:
    """Pose of the nominal machine; commands (n, 6) are a point, a tilt and a spin."""
    rx, ry, spin = command[:, 3:].T
    theta, psi = np.hypot(rx, ry), np.arctan2(ry, rx)
    R0 = about(2, psi) @ about(0, theta) @ about(2, -psi) @ about(2, spin)
    point = command[:, :3] - tool[:, None] * R0[:, :, 2]
    legs = point[:, None] + _HEX_LOCAL @ np.swapaxes(R0, 1, 2) - _HEX_BASE
    return Pose(np.hstack([point, np.zeros((len(rx), 3))]), R0, norm(legs))


HEXAPOD = Machine(
    name="hexapod",
    command=(
        ("x", "mm"),
        ("y", "mm"),
        ("z", "mm"),
        ("rx", "deg"),
        ("ry", "deg"),
        ("spin", "deg"),
    ),
    legs=6,
    parameters=(
        *(f"db{i}{k}" for i in range(1, 7) for k in XYZ),
        *(f"da{i}{k}" for i in range(1, 7) for k in XYZ),
        *(f"dl{i}" for i in range(1, 7)),
    ),
    nominal=np.zeros(42),
    tolerance=np.concatenate([np.full(36, 0.3e-3), np.full(6, 0.5e-3)]),
    extras=(),
    closure=_hex_closure,
    inverse=hexapod_inverse,
    turns=True,
    weight=300.0,
    com=0.12,
    growth=growth_points(0, _HEX_BASE, 42),
)


def leg_vectors(pose: Pose) -> Array:
    """Legs (n, 6, 3) of the nominal machine, base joint to platform, m."""
    platform = pose.x[:, None, :3] + _HEX_LOCAL @ np.swapaxes(pose.R0, 1, 2)
    return platform - _HEX_BASE
