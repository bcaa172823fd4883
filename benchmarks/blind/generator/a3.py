"""A3 head: three extensible struts on revolute joints."""

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

_A, _B, _C, _D = 0.250, 0.250, 0.526, 0.540  # m, Tian et al. 2016, Table 1
_FI = 2 * np.pi * np.arange(3) / 3 - np.pi / 2
_OUT = np.stack([np.cos(_FI), np.sin(_FI), np.zeros(3)], -1)
_AXIS = np.stack([-np.sin(_FI), np.cos(_FI), np.zeros(3)], -1)  # of the revolute joints
_A3_BASE, _A3_LOCAL = _B * _OUT, _A * _OUT - np.array([0.0, 0.0, _C])


def _a3_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    R = R0 @ cayley(x[:, 3:6])
    joint = x[:, None, :3] + points(p, 12, _A3_LOCAL) @ np.swapaxes(R, 1, 2)
    v, length = joint - points(p, 3, _A3_BASE), q + p[:, 0:3]
    return np.concatenate(
        [norm(v) - length, (v * _AXIS).sum(-1) - length * np.sin(p[:, 21:24])], -1
    )


def _a3_inverse(command: Array, tool: Array) -> Pose:
    z, psi, theta = command.T
    R0 = about(2, psi) @ about(0, theta) @ about(2, -psi)
    lean, reach = _A / 2 * (1 - np.cos(theta)), (_C + tool) * np.sin(theta)
    point = np.stack(
        [
            lean * np.sin(2 * psi) + reach * np.sin(psi),
            lean * np.cos(2 * psi) - reach * np.cos(psi),
            z,
        ],
        -1,
    )
    point = point - tool[:, None] * R0[:, :, 2]
    legs = point[:, None] + _A3_LOCAL @ np.swapaxes(R0, 1, 2) - _A3_BASE
    return Pose(np.hstack([point, np.zeros((len(z), 3))]), R0, norm(legs))


_A3_NAMES = (
    *(f"dq{i}" for i in (1, 2, 3)),
    *(f"db{i}{k}" for i in (1, 2, 3) for k in XYZ),
    *(f"da{i}{k}" for i in (1, 2, 3) for k in XYZ),
    *(f"beta{i}" for i in (1, 2, 3)),
)
_HELD = ("db1x", "db2y", "db3y", "db1z", "db2z", "db3z")
A3 = Machine(
    name="a3",
    command=(("z", "mm"), ("psi", "deg"), ("theta", "deg")),
    legs=3,
    parameters=_A3_NAMES,
    nominal=np.zeros(24),
    tolerance=np.array(
        [
            0.0 if n in _HELD else 10e-3 if n.startswith("beta") else 1e-3
            for n in _A3_NAMES
        ]
    ),
    extras=(),
    closure=_a3_closure,
    inverse=_a3_inverse,
    turns=True,
    weight=600.0,
    com=-0.25,
    growth=growth_points(3, _A3_BASE, 24),
)


def leg_vectors(pose: Pose) -> Array:
    """Legs (n, 3, 3) of the nominal machine, base joint to platform, m."""
    platform = pose.x[:, None, :3] + _A3_LOCAL @ np.swapaxes(pose.R0, 1, 2)
    return platform - _A3_BASE
