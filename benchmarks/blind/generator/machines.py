"""Four machines as exact closures in plain NumPy, and their poses.

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
    """Commanded poses of n rows."""

    #: (n, nx) reference tool points, with Gibbs vectors for machines that turn
    x: Array
    R0: Array  #: (n, 3, 3) commanded orientations
    q: Array  #: (n, nq) joints of the nominal machine


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine. Shapes: x (n, nx), R0 (n, 3, 3), q (n, nq), p (n, np + extras)."""

    name: str  #: of the machine
    command: tuple[tuple[str, str], ...]  #: (name, unit) of the commanded coordinates
    legs: int  #: number of legs
    parameters: tuple[str, ...]  #: (np,) names
    nominal: Array  #: (np,) values
    #: (np,) prior standard deviations; 0 where a parameter only chooses the base frame
    tolerance: Array
    extras: tuple[str, ...]  #: names of what no calibration knows
    #: (x, R0, q, p) -> (n, nx), zero when assembled; m
    closure: Callable[[Array, Array, Array, Array], Array]
    #: (command (n, dof), tool (n,)) -> Pose of the nominal machine; tool is the length
    #: added along the tool's axis
    inverse: Callable[[Array, Array], Pose]
    turns: bool  #: whether the platform turns
    weight: float  #: N, order of the moving mass's weight
    com: float  #: its centre behind the tool point along the tool, m
    #: spread (legs,) -> dp (np + extras,): the frame's unit expansion, by each leg's
    #: share
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


def _struts(point: Array, R0: Array, local: Array, base: Array) -> Array:
    """Struts (n, k, 3) from base joints to platform joints, at tool points and rotations."""
    return point[:, None] + local @ np.swapaxes(R0, 1, 2) - base


def growth_points(start: int, places: Array, width: int) -> Callable[[Array], Array]:
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


# -- A3 head: three extensible struts on revolute joints -------------------------------


_A, _B, _C = 0.250, 0.250, 0.526  # m, Tian et al. 2016, Table 1
_FI = 2 * np.pi * np.arange(3) / 3 - np.pi / 2
_OUT = np.stack([np.cos(_FI), np.sin(_FI), np.zeros(3)], -1)
_AXIS = np.stack([-np.sin(_FI), np.cos(_FI), np.zeros(3)], -1)  # of the revolute joints
_A3_BASE, _A3_LOCAL = _B * _OUT, _A * _OUT - np.array([0.0, 0.0, _C])


def _a3_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    R = R0 @ cayley(x[:, 3:6])
    joint = x[:, None, :3] + points(p, 12, _A3_LOCAL) @ np.swapaxes(R, 1, 2)
    v, length = joint - points(p, 3, _A3_BASE), q + p[:, 0:3]
    across = (v * _AXIS).sum(-1) - length * np.sin(p[:, 21:24])
    return np.concatenate([norm(v) - length, across], -1)


def _a3_inverse(command: Array, tool: Array) -> Pose:
    z, psi, theta = command.T
    R0 = about(2, psi) @ about(0, theta) @ about(2, -psi)
    lean, reach = _A / 2 * (1 - np.cos(theta)), (_C + tool) * np.sin(theta)
    x = lean * np.sin(2 * psi) + reach * np.sin(psi)
    y = lean * np.cos(2 * psi) - reach * np.cos(psi)
    point = np.stack([x, y, z], -1) - tool[:, None] * R0[:, :, 2]
    legs = _struts(point, R0, _A3_LOCAL, _A3_BASE)
    return Pose(np.hstack([point, np.zeros((len(z), 3))]), R0, norm(legs))


_A3_NAMES = (
    *(f"dq{i}" for i in (1, 2, 3)),
    *(f"db{i}{k}" for i in (1, 2, 3) for k in XYZ),
    *(f"da{i}{k}" for i in (1, 2, 3) for k in XYZ),
    *(f"beta{i}" for i in (1, 2, 3)),
)
_FIXED = ("db1x", "db2y", "db3y", "db1z", "db2z", "db3z")
A3 = Machine(
    name="a3",
    command=(("z", "mm"), ("psi", "deg"), ("theta", "deg")),
    legs=3,
    parameters=_A3_NAMES,
    nominal=np.zeros(24),
    tolerance=np.array(
        [0.0 if n in _FIXED else 1e-3 for n in _A3_NAMES[:21]] + [0.01] * 3
    ),
    extras=(),
    closure=_a3_closure,
    inverse=_a3_inverse,
    turns=True,
    weight=600.0,
    com=-0.25,
    growth=growth_points(3, _A3_BASE, 24),
)


# -- planar manipulator: two sliders, two struts ---------------------------------------


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


def _planar_legs(pose: Pose) -> Array:
    """Legs (n, 2, 3) of the nominal machine, carriage to platform, m."""
    side = np.broadcast_to(_SIDE * _PD, pose.q.shape)
    foot = np.stack([0 * pose.q, side, pose.q], -1)
    point = np.stack([0 * pose.x[:, 0], pose.x[:, 0], pose.x[:, 1]], -1)
    return point[:, None] - foot


# -- linear delta: three vertical sliders, three arms ----------------------------------


_DR, _DL, _DE = 0.16175, 0.345, 0.420  # m, FLSun V400
_DA = np.deg2rad([210.0, 330.0, 90.0])
_DELTA_NAMES = (
    "radius",
    *(f"{stem}{i}" for stem in ("arm", "angle", "endstop") for i in (1, 2, 3)),
)


def _delta_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    radius, arm, angle = p[:, 0:1], p[:, 1:4], p[:, 4:7]
    height = p[:, 7:10] + np.sqrt(arm**2 - radius**2) - q
    outward, sideways = radius + p[:, 10:13], p[:, 13:16]
    cx = outward * np.cos(angle) - sideways * np.sin(angle)
    cy = outward * np.sin(angle) + sideways * np.cos(angle)
    flat = (x[:, 0:1] - cx) ** 2 + (x[:, 1:2] - cy) ** 2
    return np.sqrt(flat + (x[:, 2:3] - height) ** 2) - arm


def _delta_inverse(command: Array, tool: Array) -> Pose:
    flat = (command[:, :1] - _DR * np.cos(_DA)) ** 2
    flat = flat + (command[:, 1:2] - _DR * np.sin(_DA)) ** 2
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


def _delta_legs(pose: Pose) -> Array:
    """Legs (n, 3, 3) of the nominal machine, carriage to platform, m."""
    circle = _DR * np.stack([np.cos(_DA), np.sin(_DA)], -1)
    ring = np.broadcast_to(circle, (len(pose.q), 3, 2))
    height = _DE + np.sqrt(_DL**2 - _DR**2) - pose.q
    return pose.x[:, None, :] - np.concatenate([ring, height[:, :, None]], -1)


# -- hexapod: six extensible struts ----------------------------------------------------
def _ring(radius: float, half: float, height: float) -> Array:
    degrees = [120.0 * (i // 2) + (half if i % 2 else -half) for i in range(6)]
    angle, z = np.deg2rad(degrees), np.full(6, height)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


_HEX_BASE, _HEX_LOCAL = _ring(0.300, 15.0, 0.0), _ring(0.200, 45.0, 0.100)


def _hex_closure(x: Array, R0: Array, q: Array, p: Array) -> Array:
    R = R0 @ cayley(x[:, 3:6])
    joint = x[:, None, :3] + points(p, 18, _HEX_LOCAL) @ np.swapaxes(R, 1, 2)
    return norm(joint - points(p, 0, _HEX_BASE)) - q - p[:, 36:42]


def _hexapod_inverse(command: Array, tool: Array) -> Pose:
    """Pose of the nominal machine; commands (n, 6) are a point, a tilt and a spin."""
    rx, ry, spin = command[:, 3:].T
    theta, psi = np.hypot(rx, ry), np.arctan2(ry, rx)
    R0 = about(2, psi) @ about(0, theta) @ about(2, -psi) @ about(2, spin)
    point = command[:, :3] - tool[:, None] * R0[:, :, 2]
    legs = _struts(point, R0, _HEX_LOCAL, _HEX_BASE)
    return Pose(np.hstack([point, np.zeros((len(rx), 3))]), R0, norm(legs))


HEXAPOD = Machine(
    name="hexapod",
    command=(*((n, "mm") for n in XYZ), ("rx", "deg"), ("ry", "deg"), ("spin", "deg")),
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
    inverse=_hexapod_inverse,
    turns=True,
    weight=300.0,
    com=0.12,
    growth=growth_points(0, _HEX_BASE, 42),
)


# -- all of them -----------------------------------------------------------------------
MACHINES = {m.name: m for m in (A3, PLANAR, DELTA, HEXAPOD)}
#: legs (n, legs, 3) of the nominal machine, m
LEG_VECTORS: dict[str, Callable[[Pose], Array]] = {
    "a3": lambda pose: _struts(pose.x[:, :3], pose.R0, _A3_LOCAL, _A3_BASE),
    "planar": _planar_legs,
    "delta": _delta_legs,
    "hexapod": lambda pose: _struts(pose.x[:, :3], pose.R0, _HEX_LOCAL, _HEX_BASE),
}


def joint_columns(machine: Machine, leg: int) -> tuple[list[int], list[int]]:
    """Columns of p that place a leg's base joint (or carriage) and platform joint.

    Empty where none do.
    """
    if machine.name == "a3":
        return [3 + 3 * leg + k for k in range(3)], [12 + 3 * leg + k for k in range(3)]
    if machine.name == "hexapod":
        return [3 * leg + k for k in range(3)], [18 + 3 * leg + k for k in range(3)]
    if machine.name == "planar":
        return [7 + leg, 1 + leg], []
    return [10 + leg, 13 + leg, 7 + leg], []


def leg_direction(machine: Machine, pose: Pose) -> Array:
    """Unit vectors (n, legs, 3) of the nominal machine's legs towards the platform."""
    v = LEG_VECTORS[machine.name](pose)
    return v / norm(v)[..., None]


def settle(
    machine: Machine, start: Array, R0: Array, q: Array, p: Array
) -> tuple[Array, Array]:
    """Pose x (n, nx) that closes the machine, by Newton.

    The second result is the inverse (n, nx, nx) of the last slope. Raises ArithmeticError where it does not converge.
    """
    x = start
    for _ in range(12):
        inverse = np.linalg.inv(slope(lambda v: machine.closure(v, R0, q, p), x))
        step = np.einsum("nij,nj->ni", inverse, machine.closure(x, R0, q, p))
        x = x - step
        if np.abs(step).max() < 1e-9:
            last = machine.closure(x, R0, q, p)
            return x - np.einsum("nij,nj->ni", inverse, last), inverse
    raise ArithmeticError(
        f"{machine.name}: the pose does not settle ({np.abs(step).max():.1e})"
    )


def nearby(
    machine: Machine, start: Array, inverse: Array, R0: Array, q: Array, p: Array
) -> Array:
    """As `settle`, for small changes of q and p, with a fixed slope.

    Raises ArithmeticError.
    """
    x = start
    for _ in range(40):
        step = np.einsum("nij,nj->ni", inverse, machine.closure(x, R0, q, p))
        x = x - step
        if np.abs(step).max() < 1e-13:
            return x
    raise ArithmeticError(
        f"{machine.name}: the disturbed pose does not settle ({np.abs(step).max():.1e})"
    )
