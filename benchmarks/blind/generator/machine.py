"""A machine as an exact closure in plain NumPy, and the geometry that closures share.

Every number is free to differ from row to row. A pose is the reference tool point, and
for machines that turn a Gibbs vector g (tangent of half the angle, times the axis)
against the commanded orientation R0, so that the platform's rotation is R0 C(g) with
the rational map C. All of it is polynomial or a root, so that complex input passes
through and slopes come by the complex step. SI: m, rad, N.

Parameters (names, nominal values, tolerances) mean what the models of the same machines
mean; `extras` after them are what no calibration knows (a carriage off its guide).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # real, or complex for slopes
STEP = 1e-30  # complex step
XYZ = "xyz"


@dataclasses.dataclass(frozen=True)
class Pose:
    """Commanded poses of n rows.

    x     (n, nx) reference tool points, with Gibbs vectors for machines that turn
    R0    (n, 3, 3) commanded orientations
    q     (n, nq) joints of the nominal machine
    """

    x: Array
    R0: Array
    q: Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine. Shapes: x (n, nx), R0 (n, 3, 3), q (n, nq), p (n, np + extras).

    name          of the machine
    command       (name, unit) of the commanded coordinates
    legs          number of legs
    parameters    (np,) names
    nominal       (np,) values
    tolerance     (np,) prior standard deviations; 0 where a parameter only chooses the
                  base frame
    extras        names of what no calibration knows
    closure       (x, R0, q, p) -> (n, nx), zero when assembled; m
    inverse       (command (n, dof), tool (n,)) -> Pose of the nominal machine; tool is
                  the length added along the tool's axis
    turns         whether the platform turns
    weight        N, order of the moving mass's weight
    com           its centre behind the tool point along the tool, m
    growth        spread (legs,) -> dp (np + extras,): the frame's unit expansion, by
                  each leg's share
    """

    name: str
    command: tuple[tuple[str, str], ...]
    legs: int
    parameters: tuple[str, ...]
    nominal: Array
    tolerance: Array
    extras: tuple[str, ...]
    closure: Callable[[Array, Array, Array, Array], Array]
    inverse: Callable[[Array, Array], Pose]
    turns: bool
    weight: float
    com: float
    growth: Callable[[Array], Array]

    @property
    def full(self) -> Array:
        """Nominal parameters with the extras, (np + extras,)."""
        return np.concatenate([self.nominal, np.zeros(len(self.extras))])

    def column(self, name: str) -> int:
        """Column of a parameter or extra."""
        return (*self.parameters, *self.extras).index(name)


def cayley(g: Array) -> Array:
    """Rotation (n, 3, 3) of Gibbs vectors g (n, 3); exact and rational."""
    g2 = (g * g).sum(-1)[:, None, None]
    cross = np.zeros((len(g), 3, 3), g.dtype)
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -g[:, 2], g[:, 1], -g[:, 0]
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = g[:, 2], -g[:, 1], g[:, 0]
    outer = g[:, :, None] * g[:, None, :]
    return ((1 - g2) * np.eye(3) + 2 * outer + 2 * cross) / (1 + g2)


def rotation(machine: Machine, x: Array, R0: Array) -> Array:
    """Platform to base, (n, 3, 3)."""
    return R0 @ cayley(x[:, 3:6]) if machine.turns else R0


def tip(machine: Machine, x: Array, R0: Array, tool: Array) -> Array:
    """Tool point (n, 3) of tools `tool` (n,) longer than the reference's."""
    if machine.name == "planar":
        return np.stack([0 * x[:, 0], x[:, 0], x[:, 1]], -1)
    if not machine.turns:
        return x[:, :3]
    return x[:, :3] + tool[:, None] * rotation(machine, x, R0)[:, :, 2]


def norm(v: Array) -> Array:
    """Euclidean norm over the last axis without conjugation, for the complex step."""
    return np.sqrt((v * v).sum(-1))


def about(axis: int, angle: Array) -> Array:
    """Rotation (n, 3, 3) about a base axis."""
    c, s, o, i = np.cos(angle), np.sin(angle), 0 * angle, 0 * angle + 1
    rows = [np.stack(row, -1) for row in ([c, -s, o], [s, c, o], [o, o, i])]
    z = np.stack(rows, -2)
    order = [(2 + 0 - axis + k) % 3 for k in range(3)]
    return z[:, order][:, :, order]


def points(p: Array, start: int, nominal: Array) -> Array:
    """Joint centres (n, k, 3): nominal (k, 3) plus the errors in columns start.. of p."""
    k = len(nominal)
    return nominal + p[:, start : start + 3 * k].reshape(-1, k, 3)


def growth_points(
    start: int,
    places: Array,
    width: int,
) -> Callable[[Array], Array]:
    """Growth of points: dp (width,) with places (k, 3) from column `start` on."""

    def growth(spread: Array) -> Array:
        dp = np.zeros(width)
        dp[start : start + places.size] = (spread[:, None] * places).ravel()
        return dp

    return growth


def slope(f: Callable[[Array], Array], v: Array) -> Array:
    """df/dv (n, m, k) of f: (n, k) -> (n, m), row by row, by the complex step."""
    columns = []
    for j in range(v.shape[1]):
        w = v.astype(complex)
        w[:, j] += 1j * STEP
        columns.append(f(w).imag / STEP)
    return np.stack(columns, -1)
