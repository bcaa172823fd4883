"""Tripod on two UPR legs and an SPR leg (2-UPR + SPR, as the Exechon), commanded in x, y, z.

Legs 1 and 2 have universal joints at the base, whose first axes are one line along x, and
revolute joints at the platform along its y. Leg 3 has a ball joint at the base and a
revolute joint at the platform along its x. With v_i = x + R a_i - b_i and the revolute
axis e_i, fixed to the platform,

    |v_i| = q_i + l_i,        v_i . R e_i = |v_i| sin(hinge_i).

Planes 1 and 2 together hold (b_2 - b_1) . R e = 0, so that the universal joints' axes are
square too: the machine of exact sizes has more constraints than it needs. With errors, the
planes above hold, and the universal joints give way: errors of their axes are none of the
parameters. The machine is that of P. C. Lopez-Custodio and others, Kinematics and
constraints of the Exechon robot accounting offsets due to errors in the base joint axes, J.
Mechanisms and Robotics 12, 2020, 021109, without the offsets. Geometry
(`[machine.geometry]`): base and platform, three points each, where b_1 and b_2 are on a
line along x, and a_1 and a_2 have the same y; home and reach of the workspace.
"""

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Dimension, Expr, Family, Machine, Start, Values
from pkm_models.machines.parts import coordinates, families, legs, six_dof, translation
from pkm_models.machines.parts.families import XYZ, Geometry
from pkm_models.rotation import across

LEGS = (1, 2, 3)
NAME = "tripod_upr_spr"
BASE = ((-0.350, 0.0, 0.0), (0.350, 0.0, 0.0), (0.0, 0.500, 0.0))
PLATFORM = ((-0.120, 0.0, 0.300), (0.120, 0.0, 0.300), (0.0, 0.150, 0.300))
#: axes of the revolute joints, in the platform's frame
AXES = np.array([(0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)])
SIDES = across(AXES)
OFF_LINE = 1e-6  #: share of the size by which points on one line may be off it
DIMENSIONS = (
    Dimension("base", "m", (3, 3), BASE, legs.BASE),
    Dimension("platform", "m", (3, 3), PLATFORM, legs.PLATFORM),
    *translation.ranges_dimensions((0.0, 0.0, -1.300), 0.250),
)


def _plane(x: Values, p: Values, i: int) -> Expr:
    """How far leg i is out of the plane of its revolute joint, m."""
    rotation, _ = six_dof.platform(x)
    foot, joint = legs.leg(x, p, i)
    axis = legs.direction(p, i, AXES[i - 1], SIDES[i - 1])
    v = joint - foot
    return ca.dot(rotation @ axis, v) - ca.norm_2(v) * ca.sin(p[f"hinge{i}"])


def _closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Leg lengths and planes, m."""
    lengths = [legs.leg_length(x, p, i) - q[f"q{i}"] for i in LEGS]
    return [*lengths, *[_plane(x, p, i) for i in LEGS]]


def _guess(c: Values, p: Values) -> Start:
    """The platform turned about the line of the universal joints, then about its y."""
    tip = ca.vertcat(c["x"], c["y"], c["z"])
    from_line = tip - families.point(p, "b", 1)
    turn = -ca.atan((from_line[1] + p["a1y"]) / from_line[2])
    v = tip - families.point(p, "b", 3)
    height = ca.cos(turn) * v[2] - ca.sin(turn) * v[1]
    lean = ca.atan((v[0] + p["a3x"]) / height)
    pose = [c["x"], c["y"], c["z"], turn, lean, 0.5 * turn * lean]
    x = families.by_name(six_dof.POSE, pose)
    return pose, [legs.leg_length(x, p, i) for i in LEGS]


def _refuse_what_locks(base: Array, platform: Array) -> None:
    """Refuse legs 1 and 2 whose axes do not agree. Raises ValueError."""
    slack = OFF_LINE * families.largest(base)
    along = base[1] - base[0]
    if abs(along[0]) <= slack or np.abs(along[1:]).max() > slack:
        raise ValueError(
            "base joints 1 and 2 must be on a line along x, apart from each other"
        )
    if abs(platform[1, 1] - platform[0, 1]) > slack:
        raise ValueError(
            "platform joints 1 and 2 must have the same y: their revolute axes are"
            " along y, and the legs are in one plane square to it"
        )


def build(geometry: Geometry) -> Machine:
    """A machine of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "reach")
    limbs, reach = legs.ExtensibleLegs(table), families.number(table, "reach")
    home = limbs.home
    _refuse_what_locks(limbs.base, limbs.platform)
    if np.abs(home[2] - limbs.base[:, 2]).min() <= reach:
        raise ValueError("the workspace reaches the base: move home, or reduce reach")
    return six_dof.driven(
        XYZ,
        name=NAME,
        source="Lopez-Custodio and others 2020, J. Mechanisms and Robotics 12, 021109",
        about="tripod 2-UPR + SPR (Exechon): x, y, z driven, the tilt follows",
        joints=families.around(limbs.lengths, 3.0 * reach, 3, legs.LEG),
        command=coordinates.points_about(home.tolist(), reach),
        parameters=(
            *limbs.parameters(),
            *legs.hinge_parameters(),
            *legs.tilts(AXES, "the revolute axis at the platform, leg", "platform"),
        ),
        components=legs.errors(XYZ),
        home=dict(zip(XYZ, home.tolist(), strict=True)),
        lever=limbs.size,
        closure=_closure,
        guess=_guess,
        skeleton=limbs.skeleton,
        struts=limbs.struts,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
