"""Hexapod of any geometry (6-UPS): six extensible legs, all six coordinates driven.

Leg i runs from the base joint b_i to the platform joint a_i:

    |x + R a_i - b_i| = q_i + l_i,

with 42 parameters, as in J. Wang and O. Masory, On the accuracy of a Stewart platform,
IEEE ICRA 1993, 114-120. Geometry (`[machine.geometry]`): base and platform, six points
each; home, reach and tilt of the workspace.
"""

import math

from oed.model import Dimension, Expr, Family, Machine, Start, Values
from pkm_models.machines.parts import families, legs, passive, six_dof
from pkm_models.machines.parts.families import Geometry
from pkm_models.rotation import across

LEGS = (1, 2, 3, 4, 5, 6)
NAME = "hexapod_ups"
BASE = families.ring(0.300, (-15, 15, 105, 135, 225, 255), 0.0)
PLATFORM = families.ring(0.200, (-45, 45, 75, 165, 195, 285), 0.100)
DIMENSIONS = (
    Dimension("base", "m", (6, 3), BASE, legs.BASE),
    Dimension("platform", "m", (6, 3), PLATFORM, legs.PLATFORM),
    *legs.ranges_dimensions((0.0, 0.0, 0.500), 0.100, math.radians(15.0)),
)


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Leg lengths; m."""
    return [legs.leg_length(x, p, i) - q[f"q{i}"] for i in LEGS]


def guess(c: Values, p: Values) -> Start:
    """The commanded pose and its legs."""
    return six_dof.target(c), [legs.leg_length(c, p, i) for i in LEGS]


def build(geometry: Geometry) -> Machine:
    """A hexapod of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "reach", "tilt")
    limbs, reach = legs.ExtensibleLegs(table), families.number(table, "reach")
    home, tilt = limbs.home.tolist(), families.number(table, "tilt")
    change = math.sqrt(3.0) * (reach + 2.0 * limbs.size * tilt)
    return six_dof.machine(
        name=NAME,
        source="Wang and Masory 1993, IEEE ICRA, 114-120, for the 42 parameters",
        about="hexapod of any geometry (6-UPS): x, y, z, tilt and spin driven",
        joints=families.around(limbs.lengths, change, 6, legs.LEG),
        command=six_dof.command(home, reach, tilt),
        parameters=tuple(limbs.parameters()),
        home=legs.pose_at({}, home),
        lever=limbs.size,
        closure=closure,
        guess=guess,
        skeleton=limbs.skeleton,
        struts=limbs.struts,
        passive=lambda x, q, p: passive.universals(
            limbs.struts(x, q, p), across(limbs.drawn)[:, 0], limbs.drawn
        ),
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
