"""Hexaglide: six struts of constant length on horizontal guides."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.blind.generator.hexapod import HEXAPOD, hexapod_inverse
from benchmarks.blind.generator.machine import (
    XYZ,
    Array,
    Machine,
    Pose,
    cayley,
    norm,
    points,
)

#: struts, m; x of the guides' ends, from which travel counts
_GLIDE_STRUT, _GLIDE_END = 0.800, -1.200
#: side of the platform on which each carriage is
_GLIDE_SIDE = np.tile([-1.0, 1.0], 3)
_GLIDE_BASE = np.repeat(
    [[_GLIDE_END, -0.250, 0.800], [_GLIDE_END, 0.0, 0.800], [_GLIDE_END, 0.550, 0.500]],
    2,
    axis=0,
)
_GLIDE_LOCAL = np.repeat(
    [[0.060, -0.200, 0.100], [0.170, 0.0, 0.050], [0.030, 0.100, 0.100]], 2, axis=0
)
_GLIDE_LOCAL[:, 0] *= _GLIDE_SIDE


def _glide_carriage(q: Array) -> Array:
    """Nominal carriages (n, 6, 3) at travels q (n, 6)."""
    return _GLIDE_BASE + q[:, :, None] * np.array([1.0, 0.0, 0.0])


def _glide_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    R = R0 @ cayley(x[:, 3:6])
    joint = x[:, None, :3] + points(p, 18, _GLIDE_LOCAL) @ np.swapaxes(R, 1, 2)
    aside = p[:, 6:18].reshape(-1, 6, 2) + np.stack([p[:, 48:54], p[:, 42:48]], -1)
    carriage = _glide_carriage(q) + np.concatenate([p[:, :6, None], aside], -1)
    return norm(joint - carriage) - _GLIDE_STRUT - p[:, 36:42]


def _glide_inverse(command: Array, tool: Array) -> Pose:
    # commands are those of a hexapod; the travel is the side of a right-angled triangle
    pose = hexapod_inverse(command, tool)
    away = pose.x[:, None, :3] + _GLIDE_LOCAL @ np.swapaxes(pose.R0, 1, 2) - _GLIDE_BASE
    along = np.sqrt(_GLIDE_STRUT**2 - away[:, :, 1] ** 2 - away[:, :, 2] ** 2)
    return dataclasses.replace(pose, q=away[:, :, 0] + _GLIDE_SIDE * along)


def _glide_growth(spread: Array) -> Array:
    # guides move apart; along them the scales, not the frame, locate a carriage
    dp = np.zeros(54)
    dp[6:18] = (spread[:, None] * _GLIDE_BASE[:, 1:]).ravel()
    return dp


HEXAGLIDE = Machine(
    name="hexaglide",
    command=HEXAPOD.command,
    legs=6,
    parameters=(
        *(f"dq{i}" for i in range(1, 7)),
        *(f"db{i}{k}" for i in range(1, 7) for k in "yz"),
        *(f"da{i}{k}" for i in range(1, 7) for k in XYZ),
        *(f"dl{i}" for i in range(1, 7)),
    ),
    nominal=np.zeros(42),
    tolerance=np.repeat([0.5e-3, 0.3e-3, 0.5e-3], [6, 30, 6]),
    extras=(
        *(f"out{i}" for i in range(1, 7)),
        *(f"side{i}" for i in range(1, 7)),
    ),  # up, and across in the level
    closure=_glide_closure,
    inverse=_glide_inverse,
    turns=True,
    weight=250.0,
    com=0.12,
    growth=_glide_growth,
)


def leg_vectors(pose: Pose) -> Array:
    """Legs (n, 6, 3) of the nominal machine, carriage to platform, m."""
    platform = pose.x[:, None, :3] + _GLIDE_LOCAL @ np.swapaxes(pose.R0, 1, 2)
    return platform - _glide_carriage(pose.q)
