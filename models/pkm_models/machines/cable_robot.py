"""Cable robot with one line more than degrees of freedom: the printer Hangprinter HP4
(A, B, C below, D above).

Line i runs from the mover x over the anchor A_i to its spool, a_i-fold. At the origin
it is line_i long; the motor has turned by q_i since, and the spool by t = q_i / G. A
metre of line that leaves the spool lowers the square of its radius by b, so a_i dl = r
dt with r^2 = r_i^2 - b a_i l gives r = r_i - b t / 2 and

    |A_i - x| = line_i + (r_i t - b t^2 / 4) / a_i.

This is what the firmware's k0 (sqrt(r^2 + k2 l) - r), k2 = -a b, gives for the motor,
solved for the line's change l. Lines do not stretch here. Four equations, three
unknowns: see `oed.mechanism.kinematics` for where a redundant machine settles.

The build-up b is what `[machine.geometry]` may state: each printer calibrates its own.

Numbers: github.com/tobbelobb/auto-calibration-simulation-for-hangprinter, branch
hp_mark_adjusted at 790dca2, simulation.py: gear 255/20, folds 2, 2, 2, 4, build-up
0.06875 mm, spools of 75 mm, line lengths at the origin measured by hand (read to 0.5
mm; 1 mm), anchors as "rough approximations from manual measuring" (50 mm).
"""

from __future__ import annotations

import functools
import math

import casadi as ca
import numpy as np

from oed.model import Dimension, Expr, Family, Machine, Parameter, Strut, Values
from pkm_models.machines.parts import families, translation
from pkm_models.machines.parts.coordinates import joint, point
from pkm_models.machines.parts.translation import tool_point

LINES = (1, 2, 3, 4)  # A, B, C, D
GEAR = 255.0 / 20.0
BUILDUP = 0.06875e-3  # m
FOLD = {1: 2.0, 2: 2.0, 3: 2.0, 4: 4.0}
SPOOL = 0.075  # m
LINE = {1: 1.597, 2: 1.795, 3: 1.5825, 4: 2.355}  # m
NAME = "cable_robot"
MOTOR = "turn of motor {} since the origin, paying out"
DIMENSIONS = (
    Dimension("buildup", "m", (), BUILDUP, "what a metre on a spool adds to the square of its radius, over a metre"),
)  # fmt: skip
_AT = {
    1: (1.620, -90.0),
    2: (1.800, 45.0),
    3: (1.620, 150.0),
}  # m, degrees: distance from the origin's axis, bearing
ANCHOR = {
    i: (
        round(r * math.cos(math.radians(bearing)), 6),
        round(r * math.sin(math.radians(bearing)), 6),
        -0.150,
    )
    for i, (r, bearing) in _AT.items()
} | {4: (0.0, 0.0, 2.350)}


def _line(x: Values, p: Values, i: int) -> Strut:
    """Anchor and mover (3,)."""
    return families.point(p, "anchor", i), tool_point(x)


def _closure(buildup: float, x: Values, q: Values, p: Values) -> list[Expr]:
    """Line lengths; m."""
    rows = []
    for i in LINES:
        turned = q[f"q{i}"] / GEAR
        paid_out = (p[f"radius{i}"] * turned - buildup * turned**2 / 4.0) / FOLD[i]
        anchor, mover = _line(x, p, i)
        rows.append(ca.norm_2(anchor - mover) - p[f"line{i}"] - paid_out)
    return rows


def _motor(c: Values, i: int) -> Expr:
    """Motor angle at a command, without build-up."""
    paid_out = ca.norm_2(ca.vertcat(*ANCHOR[i]) - tool_point(c)) - LINE[i]
    return FOLD[i] * paid_out / SPOOL * GEAR


def build(geometry: families.Geometry) -> Machine:
    """The robot with another build-up. Raises ValueError below 0."""
    table = families.completed(DIMENSIONS, geometry)
    buildup = families.number(table, "buildup")
    if buildup < 0.0:
        raise ValueError("buildup is below 0: a line on its spool adds to the radius")
    return translation.machine(
        (0.0, 0.0, 0.0),
        (point("x", -0.400, 0.400), point("y", -0.400, 0.400), point("z", 0.0, 1.400)),
        name=NAME,
        source="Hangprinter HP4: github.com/tobbelobb/auto-calibration-simulation-for-hangprinter (MIT), at 790dca2",
        about="cable robot, four lines for three degrees of freedom: x, y, z driven, one line redundant",
        joints=tuple(joint(f"q{i}", "rad", -1200.0, 600.0, MOTOR) for i in LINES),
        base_frame="origin where the mover was when the lines' lengths were read; z up; axes of the anchors'"
        " coordinates",
        parameters=(
            *families.places("anchor", np.array([*ANCHOR.values()]), 0.050, "anchor"),
            *(Parameter(f"radius{i}", SPOOL, 1.0e-3, "m", f"spool radius of line {i} at the origin") for i in LINES),
            *(Parameter(f"line{i}", LINE[i], 1.0e-3, "m", f"length of line {i} at the origin") for i in LINES),
        ),
        lever=1.6,
        cable_stiffness=(math.inf,) * len(LINES),
        family=family,
        closure=functools.partial(_closure, buildup),
        guess=lambda c: ([c["x"], c["y"], c["z"]], [_motor(c, i) for i in LINES]),
        skeleton=lambda x, q, p: [list(_line(x, p, i)) for i in LINES],
        struts=lambda x, q, p: [_line(x, p, i) for i in LINES],
    )  # fmt: skip


family = Family(NAME, DIMENSIONS, build)
machine = build({})
