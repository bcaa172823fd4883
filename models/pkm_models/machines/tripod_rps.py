"""Tripod of any geometry (3-RPS): three extensible legs on hinges; z and tilt driven.

Leg i runs from the hinge b_i to the platform joint a_i, with v_i = x + R a_i - b_i:

    |v_i| = q_i + l_i,        v_i . s_i = |v_i| sin(hinge_i),

where s_i is the axis of the hinge; hinge_i tilts the leg out of its plane (K. M. Lee
and D. K. Shah, Kinematic analysis of a three-degrees-of-freedom in-parallel actuated
manipulator, IEEE J. Robotics and Automation 4, 1988, 354-360). Commanded are z of the
tool point and the tilt vector rx, ry; x, y and spin follow. Geometry
(`[machine.geometry]`): base, axis and platform, one for each leg; home, reach, tilt.
"""

import math

from oed.base import Array
from oed.model import Dimension, Expr, Family, Machine, Start, Values
from pkm_models.machines.parts import coordinates, families, legs, passive, six_dof
from pkm_models.machines.parts.families import Geometry

LEGS = (1, 2, 3)
NAME = "tripod_rps"
DEGREES = (-90.0, 30.0, 150.0)
AXES = families.ring(1.0, [d + 90.0 for d in DEGREES], 0.0)
DIMENSIONS = (
    Dimension("base", "m", (3, 3), families.ring(0.250, DEGREES, 0.0), legs.BASE),
    Dimension("axis", "1", (3, 3), AXES, "axes of the hinges"),
    Dimension(
        "platform", "m", (3, 3), families.ring(0.250, DEGREES, -0.3), legs.PLATFORM
    ),
    *legs.ranges_dimensions((0.0, 0.0, 0.900), 0.100, math.radians(25.0)),
)


def _vector(x: Values, p: Values, i: int) -> Expr:
    foot, joint = legs.leg(x, p, i)
    return joint - foot


def _closure(x: Values, q: Values, p: Values, axes: Array) -> list[Expr]:
    """Leg lengths and planes; m."""
    rows = []
    for i in LEGS:
        v = _vector(x, p, i)
        rows.append(legs.leg_length(x, p, i) - q[f"q{i}"])
        rows.append(legs.hinge(v, axes[i - 1], p, i))
    return rows


def guess(c: Values, p: Values) -> Start:
    """Platform over the base, with the commanded tilt, and its legs."""
    pose = legs.tripod_start(c, p)
    x = families.by_name(six_dof.POSE, pose)
    return pose, [legs.leg_length(x, p, i) for i in LEGS]


def build(geometry: Geometry) -> Machine:
    """A tripod of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "reach", "tilt")
    axes = families.unit_vectors(table["axis"], 3)
    limbs, reach = legs.ExtensibleLegs(table), families.number(table, "reach")
    change = 2.0 * (reach + 2.0 * limbs.size * families.number(table, "tilt"))
    return six_dof.driven(
        legs.TRIPOD_COMMAND,
        name=NAME,
        source="Lee and Shah 1988, IEEE J. Robotics and Automation 4, 354-360",
        about="tripod of any geometry (3-RPS): z and tilt driven; x, y, spin parasitic",
        joints=families.around(limbs.lengths, change, 3, legs.LEG),
        command=legs.tripod_command(table),
        parameters=(*limbs.parameters(), *legs.hinge_parameters()),
        components=legs.errors(("z", "ax", "ay")),
        home={"z": float(limbs.home[2]), "rx": 0.0, "ry": 0.0},
        lever=limbs.size,
        closure=lambda x, q, p: _closure(x, q, p, axes),
        guess=guess,
        skeleton=limbs.skeleton,
        struts=limbs.struts,
        passive=lambda x, q, p: passive.hinges(
            limbs.struts(x, q, p), axes, limbs.drawn
        ),
        command_orientation=coordinates.TILT_DIRECTION,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
