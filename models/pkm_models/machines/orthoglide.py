"""Three-axis glide of any size: carriages on three guides, a platform that translates.

P. Wenger and D. Chablat, Kinematic analysis of a new parallel machine tool: the
Orthoglide, Advances in Robot Kinematics 2000, 305-314. Carriage i is at g_i + q_i u_i on
its guide, and parallelograms keep the platform upright, so that its joints can be moved to
the tool point t, and each guide by as much:

    |t - g_i - q_i u_i| = l_i.

Guides along x, y and z make an Orthoglide, parallel ones a linear delta or a Triglide.
Geometry (`[machine.geometry]`): guide, direction, strut and side of each limb; home and
reach of the workspace. A guide's point along its direction is the zero of its scale.
"""

import numpy as np

from oed.model import Expr, Family, Machine, Values
from pkm_models.machines.parts import coordinates, families, legs, translation
from pkm_models.machines.parts.carriages import GuidedStruts
from pkm_models.machines.parts.families import Geometry, limb_rows

NAME = "orthoglide"
DIMENSIONS = (
    *legs.guide_dimensions(np.zeros((3, 3)), np.eye(3), 0.310, [-1.0] * 3),
    *translation.ranges_dimensions((0.0, 0.0, 0.0), 0.070),
)


def build(geometry: Geometry) -> Machine:
    """A machine of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "strut", "reach")
    guides, home = families.array(table, "guide"), families.array(table, "home")
    along = families.unit_vectors(table["direction"], 3)
    limbs = GuidedStruts(
        along,
        limb_rows(table["side"], 3),
        joint=lambda x, p, i: translation.tool_point(x),
    )

    def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
        """Guides up to their carriages, and struts."""
        ends = zip(limbs.limbs, limbs.struts(x, q, p), strict=True)
        return [[families.point(p, "b", i), *strut] for i, strut in ends]

    strut, reach = limb_rows(table["strut"], 3), families.number(table, "reach")
    longest, span = float(strut.max()), families.largest(home - guides)
    low, high = -span - reach - longest, span + reach + longest
    sd = families.tolerance(table, longest)
    return translation.machine(
        home.tolist(),
        coordinates.points_about(home.tolist(), reach),
        name=NAME,
        source="Wenger and Chablat 2000, Advances in Robot Kinematics, 305-314",
        about="three-axis glide of any size (3-PUU with parallelograms): x, y, z driven",
        joints=families.joint_ranges(low, high, 3, legs.CARRIAGE),
        base_frame="that of the geometry's points at the base",
        parameters=(
            *families.places("b", guides, sd, "point of guide"),
            *legs.tilts(along, "guide"),
            *families.numbers("l", strut.tolist(), sd, "m", "length of strut"),
        ),
        lever=longest,
        closure=limbs.closure,
        guess=lambda c, p: ([c[n] for n in "xyz"], limbs.travels(c, p)),
        skeleton=skeleton,
        struts=limbs.struts,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
