"""Hexapod of any geometry (6-UPS): six extensible legs, all six coordinates driven.

Leg i runs from the base joint b_i to the platform joint a_i:

    |x + R a_i - b_i| = q_i + l_i,

with 42 parameters, as in J. Wang and O. Masory, On the accuracy of a Stewart platform,
IEEE ICRA 1993, 114-120. Geometry (`[machine.geometry]`): base and platform, six points
each; home, reach and tilt of the workspace.
"""

from __future__ import annotations

import math

import numpy as np

from oed.model.machine import Dimension, Expr, Family, Machine, Start, Values
from pkm_models.parts import families, legs, passive, six_dof
from pkm_models.parts.families import Geometry

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


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Base, legs, platform, tool."""
    return legs.legs_skeleton(x, p, 6)


def build(geometry: Geometry) -> Machine:
    """A hexapod of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "reach", "tilt")
    base = families.array(table, "base")
    platform = families.array(table, "platform")
    home = families.array(table, "home")
    reach = families.number(table, "reach")
    drawn = home + platform - base
    lengths = np.linalg.norm(drawn, axis=1)
    size = families.largest(platform)
    tilt = families.number(table, "tilt")
    change = math.sqrt(3.0) * (reach + 2.0 * size * tilt)
    legs_range = families.around(lengths, change, 6, legs.LEG)
    sd = families.tolerance(table, float(lengths.mean()))
    return six_dof.machine(
        name=NAME,
        source="Wang and Masory 1993, IEEE ICRA, 114-120, for the 42 parameters",
        about="hexapod of any geometry (6-UPS): x, y, z, tilt and spin driven",
        joints=legs_range,
        command=six_dof.command(home.tolist(), reach, families.number(table, "tilt")),
        parameters=(
            *families.places("b", base, sd, "base joint"),
            *families.places("a", platform, sd, "platform joint"),
            *families.numbers("l", [0.0] * 6, sd, "m", "zero of leg"),
        ),
        home=legs.pose_at({}, home.tolist()),
        lever=size,
        closure=closure,
        guess=guess,
        skeleton=skeleton,
        struts=lambda x, q, p: [legs.leg(x, p, i) for i in LEGS],
        passive=lambda x, q, p: passive.universals(
            [legs.leg(x, p, i) for i in LEGS], legs.across(drawn)[:, 0], drawn
        ),
        base_frame=legs.GEOMETRY_FRAME,
        tool_axis=legs.GEOMETRY_TOOL_AXIS,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
