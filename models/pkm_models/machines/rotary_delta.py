"""Rotary delta of any size: three cranks at the base, parallelograms to the platform.

R. Clavel, Conception d'un robot parallele rapide a 4 degres de liberte, thesis 925, EPFL
1991. The platform only translates, so that the platform's joints can be moved to the tool
point t, and each shoulder by as much towards the centre:

    |t - k_i(q_i)| = lower_i,

with the knee k_i of `pkm_models.machines.parts.cranks`. Angle q_i is 0 where the upper arm points
straight outward and grows as the knee goes down, as in LinuxCNC's rotarydeltakins. All
knees are outward of the lines from their shoulders to the platform.

Geometry (`[machine.geometry]`): radius, height, angle, upper and lower, one number for all
limbs or one for each; home and reach of the workspace. Klipper's shoulder_radius is
`radius`, its shoulder_height is `height`; of LinuxCNC's numbers, `radius` is
platformradius less footradius, and `height` is 0.
"""

import math

import numpy as np

from oed.base import Array
from oed.model import Dimension, Family, Machine
from pkm_models.machines.parts import coordinates, cranks, families, translation
from pkm_models.machines.parts.families import Geometry, limb_rows

NAME = "rotary_delta"
ANGLES = tuple(math.radians(d) for d in (270.0, 150.0, 30.0))
DIMENSIONS = (
    Dimension(
        "radius", "m", (3,), 0.155, "radius of the shoulders less the platform's"
    ),
    Dimension("height", "m", (3,), 0.0, "heights of the shoulders"),
    Dimension("angle", "rad", (3,), ANGLES, "angles of the limbs, from x to y"),
    Dimension("upper", "m", (3,), 0.350, "lengths of the upper arms"),
    Dimension("lower", "m", (3,), 0.800, "lengths of the lower arms"),
    *translation.ranges_dimensions((0.0, 0.0, -0.750), 0.200),
)


def build(geometry: Geometry) -> Machine:
    """A delta of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "upper", "lower", "reach")
    home = families.array(table, "home")
    shoulders, outward = _shoulders(table)
    if not home[2] < float(shoulders[:, 2].min()):
        raise ValueError("home must be below the shoulders")
    axis = np.cross(outward, (0.0, 0.0, -1.0))
    limbs = cranks.CrankedStruts(
        axis, outward, np.full(3, -1.0), lambda x, p, i: translation.tool_point(x)
    )
    upper, lower = limb_rows(table["upper"], 3), limb_rows(table["lower"], 3)
    sd = families.tolerance(table, float(lower.max()))
    return translation.machine(
        home.tolist(),
        coordinates.points_about(home.tolist(), families.number(table, "reach")),
        name=NAME,
        source="Clavel 1991, thesis 925, EPFL; LinuxCNC, rotarydeltakins",
        about="rotary delta of any size (3-RUU with parallelograms): x, y, z driven",
        joints=cranks.joints(3),
        base_frame=(
            "origin on the axis from which the radii count; z up; limbs at the angles"
            " from x to y that the geometry states"
        ),
        parameters=cranks.parameters(shoulders, axis, upper, lower, sd),
        lever=float(upper.max()),
        closure=limbs.closure,
        guess=limbs.start("xyz"),
        skeleton=limbs.skeleton,
        struts=limbs.struts,
        passive=limbs.passive,
        family=family,
    )


def _shoulders(table: Geometry) -> tuple[Array, Array]:
    """Shoulders (3, 3) less the platform's joints, and outward directions (3, 3)."""
    radius, height = limb_rows(table["radius"], 3), limb_rows(table["height"], 3)
    angle = limb_rows(table["angle"], 3)
    outward = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    shoulders = radius[:, None] * outward
    shoulders[:, 2] = height
    return shoulders, outward


family = Family(NAME, DIMENSIONS, build)
machine = build({})
