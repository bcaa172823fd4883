"""Hexapod with cranks (6-RUS, 6-RSS) of any geometry: struts of fixed length on six cranks.

The knee of crank i is at k_i(q_i), and its strut runs to the platform joint:

    |x + R a_i - k_i| = l_i,

with k_i as in `pkm_models.machines.parts.cranks`; see J.-P. Merlet, Parallel Robots, Springer 2006,
section 2.3, robots with six degrees of freedom. A universal or a ball joint at the knee
makes no difference to the pose. Geometry (`[machine.geometry]`): centre, axis, first,
crank, strut, side and platform, one for each limb; home, reach and tilt of the workspace.
"""

import math

import numpy as np

from oed.model import Dimension, Family, Machine
from pkm_models.machines.parts import cranks, families, legs, six_dof
from pkm_models.machines.parts.families import Geometry, limb_rows

NAME = "hexapod_rus"
CENTRES = families.ring(0.250, (-15, 15, 105, 135, 225, 255), 0.0)
PLATFORM = families.ring(0.200, (-45, 45, 75, 165, 195, 285), 0.0)
#: cranks swing in upright planes through the machine's axis, outward at angle 0
SWINGS = CENTRES / 0.250
DIMENSIONS = (
    *cranks.dimensions(
        CENTRES, np.cross(SWINGS, (0.0, 0.0, 1.0)), SWINGS, 0.120, 0.370, -1.0
    ),
    Dimension("platform", "m", (6, 3), PLATFORM, legs.PLATFORM),
    *legs.ranges_dimensions((0.0, 0.0, 0.340), 0.030, math.radians(8.0)),
)


def build(geometry: Geometry) -> Machine:
    """A machine of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "crank", "strut", "reach", "tilt")
    platform = families.array(table, "platform")
    home = families.array(table, "home")
    axis, first = cranks.directions(table["axis"], table["first"], 6)
    limbs = cranks.CrankedStruts(
        axis, first, limb_rows(table["side"], 6), legs.platform_joint
    )
    crank, strut = limb_rows(table["crank"], 6), limb_rows(table["strut"], 6)
    sd = families.tolerance(table, float(strut.max()))
    command = six_dof.command(
        home.tolist(), families.number(table, "reach"), families.number(table, "tilt")
    )
    return six_dof.machine(
        name=NAME,
        source="Merlet 2006, Parallel Robots, 2nd ed., Springer: 6-RUS robots",
        about="hexapod with cranks of any geometry (6-RUS, 6-RSS): all six driven",
        joints=cranks.joints(6),
        command=command,
        parameters=(
            *cranks.parameters(families.array(table, "centre"), axis, crank, strut, sd),
            *families.places("a", platform, sd, "platform joint"),
        ),
        home=legs.pose_at({}, home.tolist()),
        lever=families.largest(platform),
        closure=limbs.closure,
        guess=limbs.start([c.name for c in command]),
        skeleton=limbs.skeleton,
        struts=limbs.struts,
        passive=limbs.passive,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
