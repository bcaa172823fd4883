"""Tripod with a passive leg that carries a wrist of two axes (Tricept with a serial wrist).

The tripod is `tripod_passive_leg`: three legs, and a passive leg that holds its platform.
The platform carries axis 4, that carries axis 5, and that the tool, of pose (R, x). With
the axes' lines (c_i, u_i) as drawn at angles 0, where the frames of platform and tool are
one,

    R = C Rot(u_4, t_4) Rot(u_5, t_5),    t_i = q_i + zero_i,
    x = o + C [c_4 + Rot(u_4, t_4) (c_5 - c_4 + Rot(u_5, t_5) (0 - c_5))],

the platform (C, o) follows from the tool and the wrist, and the closure is that of the
tripod. Tool point and direction of the tool are commanded, its spin follows. Tripod: B.
Siciliano, Robotica 17, 1999, 437-445. Geometry (`[machine.geometry]`): that of the tripod;
wrist_point and wrist_axis, one of each axis, from the tool point at angles 0; home_tilt,
the tool's tilt at home; tilt, how far it goes either way from that.
"""

import math

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import (
    Coordinate,
    Dimension,
    Expr,
    Family,
    Machine,
    Parameter,
    Start,
    Values,
)
from pkm_models.machines import tripod_passive_leg as tripod
from pkm_models.machines.parts import coordinates, families, legs, six_dof
from pkm_models.machines.parts.families import XYZ, Geometry
from pkm_models.rotation import across, tilt_torsion

NAME = "tripod_wrist"
LEGS, AXES = (1, 2, 3), (4, 5)
COMMAND = ("x", "y", "z", "rx", "ry")
POINTS = ((0.0, 0.0, 0.250), (0.0, 0.0, 0.250))
#: axis 4 along the passive leg, axis 5 square to it
DIRECTIONS = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
TURN = math.pi  #: largest turn of a wrist axis, rad
N_ROUNDS = 3  #: times that the start's platform follows the wrist
#: sine of the angle between tool and singular directions, at home, below which it is refused
MIN_SINE = 0.05
DIMENSIONS = (
    *(d for d in tripod.DIMENSIONS if d.name not in ("home", "reach", "tolerance")),
    Dimension("wrist_point", "m", (2, 3), POINTS, "points of the wrist's axes"),
    Dimension("wrist_axis", "1", (2, 3), DIRECTIONS, "directions of the axes"),
    Dimension("home_tilt", "rad", (2,), (0.6, 0.0), "rx and ry of the tool at home"),
    *legs.ranges_dimensions((0.0, 0.0, -1.450), 0.200, 0.3),
)


class Wrist:
    """Two axes (2, 3) through points (2, 3), with their errors."""

    def __init__(self, points: Array, axes: Array, home_tilt: Array) -> None:
        self.points, self.axes = points, axes
        self.sides = across(axes)
        #: components of a point that move its axis
        self.moved = [
            [k for k in range(3) if k != int(np.argmax(np.abs(u)))] for u in axes
        ]
        #: which of two ways to a direction: the one of the smaller turns at home
        self.side = 1.0
        direction = tilt_torsion(home_tilt[0], home_tilt[1], 0.0)[:, 2]
        turns = {side: self._turn(direction, side) for side in (1.0, -1.0)}
        self.side = min(turns, key=lambda side: turns[side])

    def _turn(self, direction: Expr, side: float) -> float:
        """The larger of both turns to a direction (3,), rad."""
        self.side = side
        nominal = {p.name: p.nominal for p in self.parameters(0.0)}
        return max(abs(float(turn)) for turn in self.angles(direction, nominal))

    def parameters(self, sd: float) -> list[Parameter]:
        """Zeros, directions and places of the axes."""
        listed = []
        for i, point_, moved in zip(AXES, self.points, self.moved, strict=True):
            rad = legs.DIRECTION_SD
            about = f"of wrist axis {i}"
            listed.append(Parameter(f"zero{i}", 0.0, rad, "rad", f"zero {about}"))
            for side in "ab":
                name = f"tilt{i}{side}"
                listed.append(Parameter(name, 0.0, rad, "rad", f"tilt {about}, {side}"))
            for k in moved:
                point = float(point_[k])
                about_parameter = f"{XYZ[k]} of a point {about}"
                listed.append(
                    Parameter(f"c{i}{XYZ[k]}", point, sd, "m", about_parameter)
                )
        return listed

    def axis(self, p: Values, k: int) -> tuple[Expr, Expr]:
        """Point and direction of axis k, from 0."""
        i = AXES[k]
        point = [
            p[f"c{i}{XYZ[j]}"] if j in self.moved[k] else float(self.points[k][j])
            for j in range(3)
        ]
        direction = legs.direction(p, i, self.axes[k], self.sides[k])
        return ca.vertcat(*point), direction

    def motion(self, q: Values, p: Values) -> tuple[Expr, Expr]:
        """Rotation and shift of the tool in the platform's frame."""
        rotation, shift = ca.SX.eye(3), ca.SX.zeros(3)
        for k in (1, 0):
            point, direction = self.axis(p, k)
            turn = _rotation(direction, q[f"q{AXES[k]}"] + p[f"zero{AXES[k]}"])
            shift = point + turn @ (shift - point)
            rotation = turn @ rotation
        return rotation, shift

    def angles(self, direction: Expr, p: Values) -> list[Expr]:
        """Angles that turn z of the tool into a direction (3,) of the platform: two."""
        (_, first), (_, second) = self.axis(p, 0), self.axis(p, 1)
        z = ca.DM([0.0, 0.0, 1.0])
        cos, across = ca.dot(first, second), ca.cross(first, second)
        a, b = ca.dot(first, direction), ca.dot(second, z)
        along = ((a - cos * b) * first + (b - cos * a) * second) / (1.0 - cos**2)
        rest = ca.fmax(1.0 - ca.dot(along, along), 0.0)
        middle = along + self.side * ca.sqrt(rest) * across / ca.norm_2(across)
        return [
            _angle(first, middle, direction) - p["zero4"],
            _angle(second, z, middle) - p["zero5"],
        ]


def _rotation(axis: Expr, angle: Expr) -> Expr:
    """Rotation (3, 3) about a unit vector."""
    skew = ca.skew(axis)
    return ca.SX.eye(3) + ca.sin(angle) * skew + (1.0 - ca.cos(angle)) * skew @ skew


def _angle(axis: Expr, before: Expr, after: Expr) -> Expr:
    """The angle about a unit vector that turns one vector into another."""
    return ca.atan2(
        ca.dot(axis, ca.cross(before, after)),
        ca.dot(before, after) - ca.dot(axis, before) * ca.dot(axis, after),
    )


def carrier(x: Values, q: Values, p: Values, wrist: Wrist) -> tuple[Expr, Expr]:
    """Rotation and origin of the tripod's platform under the tool."""
    rotation, tool = six_dof.platform(x)
    turn, shift = wrist.motion(q, p)
    platform = rotation @ turn.T
    return platform, tool - platform @ shift


def _closure(
    x: Values, q: Values, p: Values, wrist: Wrist, angle: float, size: float
) -> list[Expr]:
    """Leg lengths, and what the passive leg holds; m."""
    frame = carrier(x, q, p, wrist)
    lengths = [legs.length_in(frame, p, i) - q[f"q{i}"] for i in LEGS]
    return [*lengths, *tripod.held_rows(*frame, p, angle, size)]


def _guess(c: Values, p: Values, wrist: Wrist, up: float) -> Start:
    """The platform's axis towards the pivot, the wrist towards the tool's direction."""
    tool = ca.vertcat(c["x"], c["y"], c["z"])
    tilted = tilt_torsion(c["rx"], c["ry"], 0.0)
    origin = tool
    turns = [0.0, 0.0]
    rotation, motion = ca.SX.eye(3), ca.SX.eye(3)
    for _ in range(N_ROUNDS):
        offset = up * (tripod.pivot(p) - origin)
        axis = offset / ca.norm_2(offset)
        rotation = tilt_torsion(*_tilt(axis), 0.0)
        turns = wrist.angles(rotation.T @ tilted[:, 2], p)
        motion, shift = wrist.motion(dict(zip(("q4", "q5"), turns, strict=True)), p)
        origin = tool - rotation @ shift
    spun = tilted.T @ rotation @ motion
    spin = ca.atan2(spun[1, 0], spun[0, 0])
    lengths = [legs.length_in((rotation, origin), p, i) for i in LEGS]
    return [c[n] for n in COMMAND] + [spin], [*lengths, *turns]


def _tilt(axis: Expr) -> tuple[Expr, Expr]:
    """Tilt vector that brings z to a unit vector near it."""
    sine = ca.sqrt(axis[0] ** 2 + axis[1] ** 2 + 1e-30)
    factor = ca.atan2(sine, axis[2]) / sine
    return -axis[1] * factor, axis[0] * factor


def _skeleton(x: Values, q: Values, p: Values, wrist: Wrist) -> list[list[Expr]]:
    """Base, legs, platform, passive leg, wrist and tool."""
    rotation, origin = carrier(x, q, p, wrist)
    ends = [legs.leg_in((rotation, origin), p, i) for i in LEGS]
    feet, joints = zip(*ends, strict=True)
    fourth = origin + rotation @ wrist.axis(p, 0)[0]
    tool = six_dof.platform(x)[1]
    outlines = legs.skeleton(feet, joints, x)[:-1]
    return [*outlines, [tripod.pivot(p), fourth, tool]]


def _refuse_singular(axes: Array, tilt: Array) -> None:
    """Refuse a wrist that cannot turn the tool at home. Raises ValueError."""
    if np.linalg.norm(np.cross(*axes)) < MIN_SINE:
        raise ValueError("the wrist's axes are parallel: give two directions")
    if np.hypot(*axes[1][:2]) < MIN_SINE:
        raise ValueError("wrist axis 5 is the tool's own: it does not turn it")
    if np.hypot(*axes[0][:2]) < MIN_SINE and np.hypot(*tilt) < MIN_SINE:
        raise ValueError(
            "the wrist is singular at home, where axis 4 is the tool's: give home_tilt"
        )


def _commands(table: Geometry) -> tuple[Coordinate, ...]:
    home, tilted = families.array(table, "home"), _home_tilt(table)
    reach, tilt = families.number(table, "reach"), families.number(table, "tilt")
    of = coordinates.TILT_DIRECTION
    turns = [
        coordinates.angle(n, v - tilt, v + tilt, of=of)
        for n, v in zip(COMMAND[3:], tilted.tolist(), strict=True)
    ]
    return (*coordinates.points_about(home.tolist(), reach), *turns)


def _home_tilt(table: Geometry) -> Array:
    return np.broadcast_to(families.array(table, "home_tilt"), (2,))


def build(geometry: Geometry) -> Machine:
    """A machine of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "reach", "tilt")
    limbs, pivot = legs.ExtensibleLegs(table), families.array(table, "pivot")
    home, size = limbs.home, limbs.size
    points = np.broadcast_to(families.array(table, "wrist_point"), (2, 3))
    axes = families.unit_vectors(table["wrist_axis"], 2)
    _refuse_singular(axes, _home_tilt(table))
    wrist = Wrist(points, axes, _home_tilt(table))
    reach, angle = families.number(table, "reach"), families.number(table, "first_axis")
    span = reach + families.largest(points)
    if abs(home[2] - pivot[2]) <= span:
        raise ValueError("the workspace reaches the pivot: move home, or reduce reach")
    up = 1.0 if pivot[2] > home[2] else -1.0
    sd = limbs.tolerance
    turn = "angle of wrist axis {}, right-handed about it, less its zero"
    joints = (
        *families.around(limbs.lengths, 3.0 * span, 3, legs.LEG),
        *(coordinates.joint(f"q{i}", "rad", -TURN, TURN, turn.format(i)) for i in AXES),
    )
    middle = [*home.tolist(), *_home_tilt(table).tolist()]
    return six_dof.driven(
        COMMAND,
        name=NAME,
        source="Siciliano 1999, Robotica 17, 437-445: the Tricept robot",
        about="tripod with a passive leg and a wrist of two axes: tool point and axis",
        joints=joints,
        command=_commands(table),
        parameters=(
            *limbs.parameters(),
            *tripod.passive_parameters(pivot.tolist(), sd),
            *wrist.parameters(sd),
        ),
        components=legs.errors((*XYZ, "ax", "ay")),
        home=dict(zip(COMMAND, middle, strict=True)),
        lever=size,
        closure=lambda x, q, p: _closure(x, q, p, wrist, angle, size),
        guess=lambda c, p: _guess(c, p, wrist, up),
        skeleton=lambda x, q, p: _skeleton(x, q, p, wrist),
        tool_axis="z of the frame of the geometry's points at the platform, at angles 0",
        command_orientation=coordinates.TILT_DIRECTION,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
