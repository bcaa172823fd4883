"""Hexapod with carriages (6-PUS) of any geometry: struts of fixed length on six guides.

Carriage i is at g_i + q_i u_i on its guide, and its strut runs to the platform joint:

    |x + R a_i - g_i - q_i u_i| = l_i,

as in M. Honegger, A. Codourey and E. Burdet, Adaptive control of the Hexaglide, IEEE
ICRA 1997, 543-548. Geometry (`[machine.geometry]`): guide, direction, strut, side and
platform, one for each limb; home, reach and tilt of the workspace. A guide's point
along its direction is the zero of its scale.
"""

import math

import numpy as np

from oed.model import Dimension, Family, Machine
from pkm_models.machines.parts import families, legs, six_dof
from pkm_models.machines.parts.carriages import GuidedStruts
from pkm_models.machines.parts.families import Geometry, limb_rows

NAME = "hexapod_pus"
GUIDES = families.ring(0.350, (-15, 15, 105, 135, 225, 255), 0.0)
PLATFORM = families.ring(0.200, (-45, 45, 75, 165, 195, 285), 0.050)
DIMENSIONS = (
    *legs.guide_dimensions(GUIDES, np.array([0.0, 0.0, 1.0]), 0.500, [1.0] * 6),
    Dimension("platform", "m", (6, 3), PLATFORM, legs.PLATFORM),
    *legs.ranges_dimensions((0.0, 0.0, 0.200), 0.080, math.radians(10.0)),
)


def build(geometry: Geometry) -> Machine:
    """A machine of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "strut", "reach", "tilt")
    platform = families.array(table, "platform")
    guides = families.array(table, "guide")
    home = families.array(table, "home")
    reach = families.number(table, "reach")
    along = families.unit_vectors(table["direction"], 6)
    limbs = GuidedStruts(along, limb_rows(table["side"], 6))
    strut = limb_rows(table["strut"], 6)
    size = families.largest(platform)
    span = families.largest(home + platform - guides)
    longest = float(strut.max())
    sd = families.tolerance(table, longest)
    command = six_dof.command(home.tolist(), reach, families.number(table, "tilt"))
    return six_dof.machine(
        name=NAME,
        source="Honegger, Codourey and Burdet 1997, IEEE ICRA, 543-548, generalised",
        about="hexapod with carriages of any geometry (6-PUS): all six driven",
        joints=families.joint_ranges(-span - reach, span + longest, 6, legs.CARRIAGE),
        command=command,
        parameters=(
            *families.places("b", guides, sd, "point of guide"),
            *legs.tilts(along, "guide"),
            *families.places("a", platform, sd, "platform joint"),
            *families.numbers("l", strut.tolist(), sd, "m", "length of strut"),
        ),
        home=legs.pose_at({}, home.tolist()),
        lever=size,
        family=family,
        closure=limbs.closure,
        guess=lambda c, p: (six_dof.target(c), limbs.travels(c, p)),
        skeleton=limbs.skeleton,
        struts=limbs.struts,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
