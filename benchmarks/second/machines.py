"""Machines of the second generator that the toolkit's own modules cannot hold.

Each tower of the linear delta has a radius, a place across and two tilts of its own.
The hexapod hangs, and its command has two tilts and no spin.
"""

from __future__ import annotations

import math

import casadi as ca

from oed.model import Component, Coordinate, Expr, Machine, Parameter, Values

MM = 1e-3
AXES = ("x", "y", "z")
TRANSLATION = tuple(Component(axis, "m", True) for axis in AXES)


def _on_circle(radius: float, degrees: float, z: float = 0.0) -> Expr:
    angle = math.radians(degrees)
    return ca.DM([radius * math.cos(angle), radius * math.sin(angle), z])


def _vector(values: Values, stem: str) -> Expr:
    return ca.vertcat(*[values[f"{stem}{axis}"] for axis in AXES])


def _point(x: Values) -> Expr:
    return ca.vertcat(x["x"], x["y"], x["z"])


def _offsets(stem: str, count: int, tolerance: float, about: str) -> list[Parameter]:
    return [
        Parameter(f"{stem}{k}{axis}", 0.0, tolerance, "m", f"{axis} of {about} {k}")
        for k in range(1, count + 1)
        for axis in AXES
    ]


# -- linear delta ----------------------------------------------------------------------
TOWERS = (1, 2, 3)
TOWER_RADIUS, ARM = 161.75 * MM, 345.0 * MM
DIRECTION = {k: _on_circle(1.0, 90.0 + 120.0 * k) for k in TOWERS}


def _carriage(q: Values, p: Values, k: int) -> Expr:
    """The arm's joint on tower k: its foot, and the travel along the tilted tower."""
    outwards = DIRECTION[k]
    across = ca.vertcat(-outwards[1], outwards[0], 0.0)
    foot = (TOWER_RADIUS + p[f"radius{k}"]) * outwards + p[f"tangent{k}"] * across
    axis = ca.vertcat(p[f"tilt{k}x"], p[f"tilt{k}y"], 1.0)
    return foot + (q[f"q{k}"] + p[f"dq{k}"]) * axis / ca.norm_2(axis)


def _carriage_height(c: Values, k: int) -> Expr:
    dx = c["x"] - TOWER_RADIUS * DIRECTION[k][0]
    dy = c["y"] - TOWER_RADIUS * DIRECTION[k][1]
    return c["z"] + ca.sqrt(ARM**2 - dx**2 - dy**2)


def _tower_parameters(k: int) -> list[Parameter]:
    length, angle = 0.3 * MM, 1e-3
    return [
        Parameter(f"dq{k}", 0.0, 0.5 * MM, "m", f"zero of carriage {k}"),
        Parameter(f"l{k}", ARM, length, "m", f"length of arm {k}"),
        Parameter(f"radius{k}", 0.0, length, "m", f"tower {k} outwards"),
        Parameter(f"tangent{k}", 0.0, length, "m", f"tower {k} across"),
        Parameter(f"tilt{k}x", 0.0, angle, "rad", f"tilt of tower {k} along x"),
        Parameter(f"tilt{k}y", 0.0, angle, "rad", f"tilt of tower {k} along y"),
    ]


delta = Machine(
    name="delta_of_towers",
    source="data format of the second generator",
    about="linear delta, each tower with its own radius, place across and tilts",
    pose=tuple(Coordinate(axis, "m") for axis in AXES),
    joints=tuple(Coordinate(f"q{k}", "m", 50.0 * MM, 900.0 * MM) for k in TOWERS),
    command=(
        Coordinate("x", "m", -140.0 * MM, 140.0 * MM),
        Coordinate("y", "m", -140.0 * MM, 140.0 * MM),
        Coordinate("z", "m", 0.0, 400.0 * MM),
    ),
    home={"x": 0.0, "y": 0.0, "z": 20.0 * MM},
    parameters=tuple(p for k in TOWERS for p in _tower_parameters(k)),
    components=TRANSLATION,
    lever=TOWER_RADIUS,
    closure=lambda x, q, p: [
        ca.norm_2(_point(x) - _carriage(q, p, k)) - p[f"l{k}"] for k in TOWERS
    ],
    platform=lambda x: (ca.SX.eye(3), _point(x)),
    commanded=lambda x, tip: [tip[0], tip[1], tip[2]],
    target=lambda c: [c[axis] for axis in AXES],
    guess=lambda c: (
        [c[axis] for axis in AXES],
        [_carriage_height(c, k) for k in TOWERS],
    ),
    struts=lambda x, q, p: [(_carriage(q, p, k), _point(x)) for k in TOWERS],
)

# -- hanging hexapod -------------------------------------------------------------------
LEGS = (1, 2, 3, 4, 5, 6)
ANGLES = ("alpha", "beta", "gamma")
BASE_RADIUS, PLATFORM_RADIUS, ABOVE = 550.0 * MM, 210.0 * MM, 140.0 * MM
BASE_DEGREES = (-12.0, 12.0, 108.0, 132.0, 228.0, 252.0)
PLATFORM_DEGREES = (-48.0, 48.0, 72.0, 168.0, 192.0, 288.0)
BASE = [_on_circle(BASE_RADIUS, a) for a in BASE_DEGREES]
PLATFORM = [_on_circle(PLATFORM_RADIUS, a, ABOVE) for a in PLATFORM_DEGREES]


def _rotation_about(axis: int, angle: Expr) -> Expr:
    """Rotation (3, 3) about a coordinate axis, by its number."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = ca.SX.eye(3)
    matrix[first, first] = matrix[second, second] = ca.cos(angle)
    matrix[second, first] = ca.sin(angle)
    matrix[first, second] = -ca.sin(angle)
    return matrix


def _orientation(x: Values) -> Expr:
    first, second, third = (
        _rotation_about(axis, x[name]) for axis, name in enumerate(ANGLES)
    )
    return first @ second @ third


def _leg_ends(x: Values, q: Values, p: Values) -> list[tuple[Expr, Expr]]:
    """Base and platform joint of each leg, in the base frame."""
    rotation, tip = _orientation(x), _point(x)
    return [
        (
            BASE[k - 1] + _vector(p, f"db{k}"),
            tip + rotation @ (PLATFORM[k - 1] + _vector(p, f"da{k}")),
        )
        for k in LEGS
    ]


TILT = math.radians(10.0)
hexapod = Machine(
    name="hanging_hexapod",
    source="data format of the second generator",
    about="6-UPS hexapod whose platform hangs below the base",
    pose=(
        *(Coordinate(axis, "m") for axis in AXES),
        *(Coordinate(angle, "rad") for angle in ANGLES),
    ),
    joints=tuple(Coordinate(f"q{k}", "m", 300.0 * MM, 1300.0 * MM) for k in LEGS),
    command=(
        Coordinate("x", "m", -300.0 * MM, 300.0 * MM),
        Coordinate("y", "m", -300.0 * MM, 300.0 * MM),
        Coordinate("z", "m", -820.0 * MM, -600.0 * MM),
        *(Coordinate(angle, "rad", -TILT, TILT) for angle in ANGLES),
    ),
    home={"x": 0.0, "y": 0.0, "z": -760.0 * MM} | dict.fromkeys(ANGLES, 0.0),
    parameters=(
        *(Parameter(f"dq{k}", 0.0, 0.3 * MM, "m", f"zero of leg {k}") for k in LEGS),
        *_offsets("db", 6, 0.1 * MM, "base joint"),
        *_offsets("da", 6, 0.1 * MM, "platform joint"),
    ),
    components=(*TRANSLATION, *(Component(f"a{axis}", "rad", True) for axis in AXES)),
    lever=PLATFORM_RADIUS,
    closure=lambda x, q, p: [
        ca.norm_2(top - foot) - q[f"q{k}"] - p[f"dq{k}"]
        for k, (foot, top) in zip(LEGS, _leg_ends(x, q, p), strict=True)
    ],
    platform=lambda x: (_orientation(x), _point(x)),
    commanded=lambda x, tip: [tip[0], tip[1], tip[2], *[x[a] for a in ANGLES]],
    target=lambda c: [c[name] for name in (*AXES, *ANGLES)],
    guess=lambda c: ([c[name] for name in (*AXES, *ANGLES)], [-ABOVE - c["z"]] * 6),
    read_error=lambda c, twist: twist,
    struts=_leg_ends,
)
