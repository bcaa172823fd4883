"""Tripod with carriages (3-PRS) of any geometry: struts of fixed length on hinges.

Carriage i is at b_i + q_i u_i on its guide and carries a hinge of axis s_i; with v_i =
x + R a_i - b_i - q_i u_i the strut to the platform joint obeys

    |v_i| = l_i,        v_i . s_i = |v_i| sin(hinge_i),

as in J. A. Carretero et al., Kinematic analysis and optimization of a new three
degree-of-freedom spatial parallel manipulator, J. Mechanical Design 122 (2000) 17-24.
Commanded are z of the tool point and the tilt vector rx, ry. Geometry
(`[machine.geometry]`): guide, direction, strut, side, axis and platform, one for each
limb; home, reach and tilt of the workspace.
"""

import math

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Dimension, Expr, Family, Machine, Start, Values
from pkm_models.machines.parts import coordinates, families, legs, passive, six_dof
from pkm_models.machines.parts.carriages import GuidedStruts
from pkm_models.machines.parts.families import Geometry, limb_rows

NAME = "tripod_prs"
DEGREES = (0.0, 120.0, 240.0)
GUIDES = families.ring(0.350, DEGREES, 0.0)
AXES = families.ring(1.0, [d + 90.0 for d in DEGREES], 0.0)
PLATFORM = families.ring(0.200, DEGREES, 0.300)
DIMENSIONS = (
    *legs.guide_dimensions(GUIDES, np.array([0.0, 0.0, 1.0]), 0.800, [1.0] * 3),
    Dimension("axis", "1", (3, 3), AXES, "axes of the hinges"),
    Dimension("platform", "m", (3, 3), PLATFORM, legs.PLATFORM),
    *legs.ranges_dimensions((0.0, 0.0, 0.300), 0.150, math.radians(25.0)),
)


def _builder(along: Array, axes: Array, side: Array) -> dict[str, object]:
    """Closure, start, drawing and struts for these guides and hinges."""
    limbs = GuidedStruts(along, side)

    def closure(x: Values, q: Values, p: Values) -> list[Expr]:
        rows = []
        for i in limbs.limbs:
            carriage, joint = limbs.ends(x, q, p, i)
            v = joint - carriage
            rows.append(ca.norm_2(v) - p[f"l{i}"])
            rows.append(legs.hinge(v, axes[i - 1], p, i))
        return rows

    def guess(c: Values, p: Values) -> Start:
        pose = legs.tripod_start(c, p)
        x = families.by_name(six_dof.POSE, pose)
        return pose, limbs.travels(x, p)

    return {
        "closure": closure,
        "guess": guess,
        "skeleton": limbs.skeleton,
        "struts": limbs.struts,
        "passive": lambda x, q, p: passive.hinges(
            limbs.struts(x, q, p), axes, -side[:, None] * along
        ),
    }


def build(geometry: Geometry) -> Machine:
    """A tripod of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "strut", "reach", "tilt")
    platform = families.array(table, "platform")
    guides = families.array(table, "guide")
    home = families.array(table, "home")
    along = families.unit_vectors(table["direction"], 3)
    axes = families.unit_vectors(table["axis"], 3)
    strut = limb_rows(table["strut"], 3)
    size = families.largest(platform)
    span = families.largest(home + platform - guides)
    reach = families.number(table, "reach")
    longest = float(strut.max())
    sd = families.tolerance(table, longest)
    return six_dof.driven(
        legs.TRIPOD_COMMAND,
        name=NAME,
        source="Carretero et al. 2000, J. Mechanical Design 122, 17-24",
        about="tripod with carriages of any geometry (3-PRS): z and tilt driven",
        joints=families.joint_ranges(-span - reach, span + longest, 3, legs.CARRIAGE),
        command=legs.tripod_command(table),
        parameters=(
            *families.places("b", guides, sd, "point of guide"),
            *legs.tilts(along, "guide"),
            *families.places("a", platform, sd, "platform joint"),
            *families.numbers("l", strut.tolist(), sd, "m", "length of strut"),
            *legs.hinge_parameters(),
        ),
        components=legs.errors(("z", "ax", "ay")),
        home={"z": float(home[2]), "rx": 0.0, "ry": 0.0},
        lever=size,
        command_orientation=coordinates.TILT_DIRECTION,
        family=family,
        **_builder(along, axes, limb_rows(table["side"], 3)),
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
