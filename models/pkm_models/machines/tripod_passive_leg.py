"""Tripod with a passive leg (3-UPS + UP, as the Tricept), commanded in x, y and z.

Three legs drive the platform, and a passive leg holds it: a prismatic leg, fixed to the
platform, through a universal joint at the pivot. With v_i = x + R a_i - b_i and w = R^T
(pivot - x), the pivot as seen from the platform,

    |v_i| = q_i + l_i,
    w_x = leg_x + lean_x w_z,        w_y = leg_y + lean_y w_z,
    n_1 . R n_2 = square:

the pivot lies on the leg's line, and the joint's axes n_1, at the base, and n_2, at the
platform, are square (B. Siciliano, The Tricept robot: inverse kinematics,
manipulability analysis and closed-loop direct kinematics algorithm, Robotica 17, 1999,
437-445). Geometry (`[machine.geometry]`): base and platform, three points each; pivot;
first_axis, the direction of n_1 about z from x; home and reach of the workspace.
"""

import dataclasses
import math

import casadi as ca

from oed.model import (
    Dimension,
    Expr,
    Family,
    Machine,
    Parameter,
    PassiveJoint,
    Start,
    Values,
)
from pkm_models.machines.parts import (
    coordinates,
    families,
    legs,
    passive,
    six_dof,
    translation,
)
from pkm_models.machines.parts.families import XYZ, Geometry

LEGS = (1, 2, 3)
NAME = "tripod_passive_leg"
DEGREES = (90.0, 210.0, 330.0)
DIMENSIONS = (
    Dimension("base", "m", (3, 3), families.ring(0.400, DEGREES, 0.0), legs.BASE),
    Dimension(
        "platform", "m", (3, 3), families.ring(0.200, DEGREES, 0.3), legs.PLATFORM
    ),
    Dimension("pivot", "m", (3,), (0.0, 0.0, 0.0), "the universal joint's centre"),
    Dimension("first_axis", "rad", (), 0.0, "direction of the joint's base axis"),
    *translation.ranges_dimensions((0.0, 0.0, -1.200), 0.250),
)


def pivot(p: Values) -> Expr:
    return ca.vertcat(*[p[f"pivot_{k}"] for k in XYZ])


def _axes(p: Values, angle: float) -> tuple[Expr, Expr]:
    """The joint's axes: the first in the base frame, the second in the platform's."""
    cos, sin = math.cos(angle), math.sin(angle)
    turned = ca.vertcat(
        cos - p["axis_turn"] * sin, sin + p["axis_turn"] * cos, p["axis_rise"]
    )
    return turned / ca.norm_2(turned), ca.DM([-sin, cos, 0.0])


def _closure(x: Values, q: Values, p: Values, angle: float, size: float) -> list[Expr]:
    """Leg lengths, and what the passive leg holds; m."""
    lengths = [legs.leg_length(x, p, i) - q[f"q{i}"] for i in LEGS]
    return [*lengths, *held_rows(*six_dof.platform(x), p, angle, size)]


def held_rows(
    rotation: Expr, origin: Expr, p: Values, angle: float, size: float
) -> list[Expr]:
    """The pivot on the passive leg's line, and square axes, of a platform; m."""
    w = rotation.T @ (pivot(p) - origin)
    first, second = _axes(p, angle)
    square = size * (ca.dot(first, rotation @ second) - p["square"])
    sideways = [
        w[k] - p[f"leg_{n}"] - p[f"lean_{n}"] * w[2] for k, n in enumerate("xy")
    ]
    return [*sideways, square]


def _guess(c: Values, p: Values, up: float) -> Start:
    """The platform's axis towards the pivot (up = 1) or away from it (-1)."""
    tip = ca.vertcat(c["x"], c["y"], c["z"])
    axis = up * (pivot(p) - tip) / ca.norm_2(pivot(p) - tip)
    pose = [c["x"], c["y"], c["z"], -axis[1], axis[0], 0.0]
    x = families.by_name(six_dof.POSE, pose)
    return pose, [legs.leg_length(x, p, i) for i in LEGS]


def _passive(x: Values, p: Values, angle: float, up: float) -> list[PassiveJoint]:
    """Length of the passive leg, its turn about the first axis, its lean along it."""
    _, origin = six_dof.platform(x)
    first, _ = _axes(p, angle)
    strut = (pivot(p), origin)
    upright = passive.DOWN if up > 0.0 else passive.UP
    swing, side = passive.universals([strut], [first], upright)
    about = "length of the passive leg, from its pivot to the tool point"
    length = PassiveJoint("slide", "m", ca.norm_2(origin - pivot(p)), about)
    return [
        length,
        dataclasses.replace(swing, name="swing"),
        dataclasses.replace(side, name="side"),
    ]


def passive_parameters(pivot: list[float], sd: float) -> list[Parameter]:
    rad = legs.DIRECTION_SD
    return [
        *(
            Parameter(f"pivot_{k}", v, sd, "m", f"{k} of the pivot")
            for k, v in zip(XYZ, pivot, strict=True)
        ),
        *(
            Parameter(f"leg_{k}", 0.0, sd, "m", f"{k} of the leg at the tool")
            for k in "xy"
        ),
        *(
            Parameter(f"lean_{k}", 0.0, rad, "rad", f"lean of the leg in {k}")
            for k in "xy"
        ),
        Parameter(
            "axis_turn", 0.0, rad, "rad", "turn of the joint's base axis about z"
        ),
        Parameter("axis_rise", 0.0, rad, "rad", "rise of the joint's base axis"),
        Parameter("square", 0.0, rad, "rad", "squareness of the joint's axes"),
    ]


def build(geometry: Geometry) -> Machine:
    """A machine of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "reach")
    limbs, reach = legs.ExtensibleLegs(table), families.number(table, "reach")
    home, size = limbs.home, limbs.size
    centre, angle = families.array(table, "pivot"), float(table["first_axis"])
    if abs(home[2] - centre[2]) <= reach:
        raise ValueError("the workspace reaches the pivot: move home, or reduce reach")
    up = 1.0 if centre[2] > home[2] else -1.0
    return six_dof.driven(
        XYZ,
        name=NAME,
        source="Siciliano 1999, Robotica 17, 437-445: the Tricept robot",
        about="tripod with a passive leg (3-UPS + UP): x, y, z driven, the tilt follows",
        joints=families.around(limbs.lengths, 3.0 * reach, 3, legs.LEG),
        command=coordinates.points_about(home.tolist(), reach),
        parameters=(
            *limbs.parameters(),
            *passive_parameters(centre.tolist(), limbs.tolerance),
        ),
        components=legs.errors(XYZ),
        home=dict(zip(XYZ, home.tolist(), strict=True)),
        lever=size,
        closure=lambda x, q, p: _closure(x, q, p, angle, size),
        guess=lambda c, p: _guess(c, p, up),
        skeleton=lambda x, q, p: [
            *limbs.skeleton(x, q, p),
            [pivot(p), six_dof.platform(x)[1]],
        ],
        struts=limbs.struts,
        passive=lambda x, q, p: _passive(x, p, angle, up),
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
