"""Five-bar linkage of any size (2-RR, SCARA-like): two cranks and two struts in a plane.

    |t - k_i(q_i)| = l_i,        i = 1, 2,

with the tool point t and the knees k_i of `pkm_models.machines.parts.cranks` in the plane z = 0; see
J.-P. Merlet, Parallel Robots, Springer 2006. Angles count from x to y. Geometry
(`[machine.geometry]`): centre, crank, strut and side of each limb; home and reach of the
workspace.
"""

import numpy as np

from oed.model import Dimension, Family, Machine
from pkm_models.machines.parts import coordinates, cranks, families, translation
from pkm_models.machines.parts.families import Geometry, limb_rows

NAME = "five_bar"
CENTRES = ((-0.100, 0.0), (0.100, 0.0))
DIMENSIONS = (
    Dimension("centre", "m", (2, 2), CENTRES, "centres of the cranks"),
    Dimension("crank", "m", (2,), 0.200, "lengths of the cranks"),
    Dimension("strut", "m", (2,), 0.300, "lengths of the struts"),
    Dimension("side", "1", (2,), (1.0, -1.0), cranks.SIDE),
    *translation.ranges_dimensions((0.0, 0.300), 0.080),
)


def build(geometry: Geometry) -> Machine:
    """A linkage of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "crank", "strut", "reach")
    centre, home = families.array(table, "centre"), families.array(table, "home")
    limbs = cranks.CrankedStruts(
        axis=np.tile([0.0, 0.0, 1.0], (2, 1)),
        first=np.tile([1.0, 0.0, 0.0], (2, 1)),
        side=limb_rows(table["side"], 2),
        joint=lambda x, p, i: translation.tool_point(x),
        flat=True,
    )
    crank, strut = limb_rows(table["crank"], 2), limb_rows(table["strut"], 2)
    sd = families.tolerance(table, float(strut.max()))
    return translation.machine(
        home.tolist(),
        coordinates.points_about(home.tolist(), families.number(table, "reach")),
        name=NAME,
        source="Merlet 2006, Parallel Robots, 2nd ed., Springer: planar robots",
        about="five-bar linkage of any size (SCARA-like): x, y driven",
        joints=cranks.joints(2),
        base_frame="that of the cranks' centres; the machine moves in the plane z = 0",
        parameters=cranks.parameters(centre, limbs.axis, crank, strut, sd),
        lever=float(crank.max()),
        closure=limbs.closure,
        guess=limbs.start("xy"),
        skeleton=limbs.skeleton,
        struts=limbs.struts,
        passive=limbs.passive,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
