"""Pentapod of any geometry: five legs on collars about the tool axis (as Metrom, pentakins).

Leg i runs from its base joint b_i to a collar that turns freely about the tool axis, at
height h_i from the tool point, and is held at radius r_i of it, towards b_i:

    ((zeta - h_i)^2 + (rho - r_i)^2)^1/2 - l_i = q_i,

with zeta the height of b_i above the tool point along the tool axis, and rho its distance
from that axis, as in LinuxCNC's pentakins. The spin about the tool axis has no meaning, and
is none of the pose. Geometry (`[machine.geometry]`): base, height and radius of each leg;
home, reach and tilt of the workspace.
"""

import casadi as ca
import numpy as np

from oed.model import Dimension, Expr, Family, Machine, Start, Strut, Values
from pkm_models.machines.parts import coordinates, families, legs, six_dof
from pkm_models.machines.parts.families import Geometry, limb_rows, point
from pkm_models.rotation import tilt_torsion

NAME = "pentapod"
LEGS = (1, 2, 3, 4, 5)
COMMAND = ("x", "y", "z", "rx", "ry")
BASE = np.vstack(
    [
        families.ring(0.800, (90, 210, 330), 1.200),
        families.ring(0.900, (45, 135), 0.200),
    ]
)
DIMENSIONS = (
    Dimension("base", "m", (5, 3), BASE, legs.BASE),
    Dimension("height", "m", (5,), (0.7, 0.7, 0.7, 0.1, 0.1), "heights of the collars"),
    Dimension("radius", "m", (5,), 0.080, "radii of the collars"),
    *legs.ranges_dimensions((0.0, 0.0, 0.0), 0.100, 0.3),
)


def platform(x: Values) -> tuple[Expr, Expr]:
    """Orientation without spin, and tool point."""
    return tilt_torsion(x["rx"], x["ry"], 0.0), ca.vertcat(x["x"], x["y"], x["z"])


def leg(x: Values, p: Values, i: int) -> Strut:
    """Ends (3,) of a leg, at the base and at its collar."""
    rotation, tool = platform(x)
    axis = rotation[:, 2]
    foot = point(p, "b", i)
    offset = foot - tool
    across = offset - ca.dot(offset, axis) * axis
    outward = across / ca.norm_2(across)
    return foot, tool + p[f"h{i}"] * axis + p[f"r{i}"] * outward


def _length(x: Values, p: Values, i: int) -> Expr:
    foot, collar = leg(x, p, i)
    return ca.norm_2(collar - foot) - p[f"l{i}"]


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Leg lengths, m."""
    return [_length(x, p, i) - q[f"q{i}"] for i in LEGS]


def guess(c: Values, p: Values) -> Start:
    """The commanded pose, and its legs."""
    return [c[n] for n in COMMAND], [_length(c, p, i) for i in LEGS]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Legs, and the tool axis."""
    rotation, tool = platform(x)
    ends = [leg(x, p, i) for i in LEGS]
    top = tool + p["h1"] * rotation[:, 2]
    return [[tool, top], *[list(strut) for strut in ends]]


def build(geometry: Geometry) -> Machine:
    """A pentapod of this geometry. Raises ValueError where it makes none."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "radius", "reach", "tilt")
    base, home = families.array(table, "base"), families.array(table, "home")
    height, radius = limb_rows(table["height"], 5), limb_rows(table["radius"], 5)
    reach, tilt = families.number(table, "reach"), families.number(table, "tilt")
    offset = base - home
    across = np.linalg.norm(offset[:, :2], axis=1)
    if (across <= radius).any():
        raise ValueError("a base joint is nearer to the tool axis than its collar")
    lengths = np.hypot(offset[:, 2] - height, across - radius)
    change = 2.0 * (reach + float(np.abs(height).max()) * tilt)
    sd = families.tolerance(table, float(lengths.mean()))
    of = coordinates.TILT_DIRECTION
    turns = tuple(coordinates.angle(n, -tilt, tilt, of=of) for n in COMMAND[3:])
    return Machine(
        name=NAME,
        source="LinuxCNC, src/emc/kinematics/pentakins.c",
        about="pentapod of any geometry (5 legs on collars): tool point and axis driven",
        pose=coordinates.points()
        + tuple(coordinates.angle(n, of=of) for n in COMMAND[3:]),
        joints=families.around(lengths, change, 5, legs.LEG),
        command=(*coordinates.points_about(home.tolist(), reach), *turns),
        parameters=(
            *families.places("b", base, sd, "base joint"),
            *families.numbers("h", height.tolist(), sd, "m", "height of collar"),
            *families.numbers("r", radius.tolist(), sd, "m", "radius of collar"),
            *families.numbers("l", [0.0] * 5, sd, "m", "zero of leg"),
        ),
        components=(
            *coordinates.point_errors(),
            *(coordinates.turn_error(n) for n in ("ax", "ay")),
        ),
        home=dict(zip("xyz", home.tolist(), strict=True)) | {"rx": 0.0, "ry": 0.0},
        lever=float(np.abs(height).max()),
        closure=closure,
        platform=platform,
        commanded=lambda x, tip: [tip[0], tip[1], tip[2], x["rx"], x["ry"]],
        target=lambda c: [c[n] for n in COMMAND],
        guess=guess,
        read_error=lambda c, twist: list(twist[:5]),
        skeleton=skeleton,
        struts=lambda x, q, p: [leg(x, p, i) for i in LEGS],
        base_frame=six_dof.GEOMETRY_FRAME,
        tool_axis="along the tool, from the tool point to the collars",
        orientation=of,
        command_orientation=of,
        family=family,
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
