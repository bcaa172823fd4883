"""Hexaglide: a platform on six struts of fixed length, each on a carriage; all six
coordinates driven.

The carriages run on three parallel guides along the base's x axis, two on each.
Carriage i is at B_i + (q_i + dq_i) u, u along x and q_i the travel from the guide's
end, and its strut runs to the platform joint A_i:

    |x + R A_i - (B_i + (q_i + dq_i) u)| = L_i + dl_i.

After M. Honegger, A. Codourey and E. Burdet, Adaptive control of the Hexaglide, a 6 dof
parallel manipulator, IEEE ICRA 1997, 543-548. 42 parameters: carriage zeros (6),
guides' places across the travel at each carriage (12), platform joints (18), strut
lengths (6). The geometry is a generic one chosen here: the platform hangs below guides
at three places in y and two heights; its joints go by pairs, each pair's carriages on
either side of it. Over +-100 mm and +-12 degrees the lines of the six struts stay well
apart: the least singular value of their Pluecker matrix, moments in units of 200 mm, is
0.3 and the largest 2.2. Tolerances: joints and guides 0.3 mm, zeros and struts 0.5 mm.
No parameter is held: a pose read in a known frame sees the guides' common place, which
a free frame would hide.
"""

import math

import casadi as ca
import numpy as np

from oed.model import Expr, PointGroup, Values
from pkm_models.machines.parts import families, six_dof
from pkm_models.machines.parts.coordinates import joint
from pkm_models.machines.parts.six_dof import XYZ, command, platform, target

LEGS = (1, 2, 3, 4, 5, 6)
STRUT = 0.800  # m
START = -1.200  # m, x of the guides' ends
HEIGHT = 0.200  # m, z at home
PLATFORM = 0.200  # m
# Tolerances (prior standard deviations), m
JOINT_SD = 0.3e-3
ZERO_SD = 0.5e-3
LENGTH_SD = 0.5e-3
TRAVEL = "travel of carriage {} from its guide's end, towards +x, less its zero"
Point = tuple[float, float, float]

GUIDE = ((-0.250, 0.800), (0.000, 0.800), (0.550, 0.500))  # y and z, m
PAIR = (
    (0.060, -0.200, 0.100),
    (0.170, 0.000, 0.050),
    (0.030, 0.100, 0.100),
)  # platform joint at +x, its partner at -x
SIDE = {
    i: -1.0 if i % 2 else 1.0 for i in LEGS
}  # carriages 1, 3, 5 towards -x of the platform
B: dict[int, Point] = {i: (START, *GUIDE[(i - 1) // 2]) for i in LEGS}
A: dict[int, Point] = {
    i: (SIDE[i] * PAIR[(i - 1) // 2][0], *PAIR[(i - 1) // 2][1:]) for i in LEGS
}  # from the tool point


def _travel(i: int, x: Expr, y: Expr, z: Expr) -> Expr:
    """Travel of carriage i for a level platform with its tool point at x, y, z; m."""
    across = (y + A[i][1] - B[i][1]) ** 2 + (z + A[i][2] - B[i][2]) ** 2
    return x + A[i][0] - START + SIDE[i] * ca.sqrt(STRUT**2 - across)


def _joints(x: Values, q: Values, p: Values) -> list[tuple[Expr, Expr]]:
    """Joint centres of each strut at carriage and platform, in the base frame."""
    rotation, point = platform(x)
    joints = []
    for i in LEGS:
        travelled = B[i][0] + (q[f"q{i}"] + p[f"dq{i}"])
        across = families.shifted(B[i][1:], p, f"db{i}", "yz")
        carriage = ca.vertcat(travelled, *across)
        local = families.shifted(A[i], p, f"da{i}")
        joints.append((carriage, point + rotation @ ca.vertcat(*local)))
    return joints


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Strut lengths; m."""
    return [
        ca.norm_2(a - b) - STRUT - p[f"dl{i}"]
        for i, (b, a) in zip(LEGS, _joints(x, q, p), strict=True)
    ]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Guides, struts, platform, spindle."""
    feet, joints = zip(*_joints(x, q, p), strict=True)
    rails = [
        [ca.vertcat(end, *foot[1:]) for end in (START, -START)]
        for foot in (B[1], B[3], B[5])
    ]
    struts = [[b, a] for b, a in zip(feet, joints, strict=True)]
    around = [joints[i - 1] for i in (1, 2, 4, 6, 5, 3, 1)]
    return [*rails, *struts, around, [sum(joints[1:], joints[0]) / 6.0, platform(x)[1]]]


machine = six_dof.machine(
    name="hexaglide",
    source=(
        "Honegger, Codourey and Burdet 1997, IEEE ICRA, 543-548, for the type; a generic geometry"
    ),
    about="hexaglide (6-PUS on parallel guides): x, y, z, tilt and spin driven",
    joints=tuple(
        joint(f"q{i}", "m", *((0.2, 0.9) if SIDE[i] < 0.0 else (1.5, 2.2)), TRAVEL)
        for i in LEGS
    ),
    command=command((0.0, 0.0, HEIGHT), 0.100, math.radians(12.0)),
    base_frame="x along the guides, z up, origin below the middle of their travel",
    tool_axis="from the tool point to the platform, up at home",
    parameters=(
        *families.numbers("dq", [0.0] * 6, ZERO_SD, "m", "zero of carriage"),
        *families.places(
            "db", np.zeros((6, 2)), JOINT_SD, "the guide at carriage", "yz"
        ),
        *families.places("da", np.zeros((6, 3)), JOINT_SD, "platform joint"),
        *families.numbers("dl", [0.0] * 6, LENGTH_SD, "m", "length of strut"),
    ),
    home={"x": 0.0, "y": 0.0, "z": HEIGHT, "rx": 0.0, "ry": 0.0, "spin": 0.0},
    lever=PLATFORM,
    closure=closure,
    guess=lambda c: (target(c), [_travel(i, *(c[n] for n in XYZ)) for i in LEGS]),
    skeleton=skeleton,
    struts=lambda x, q, p: _joints(x, q, p),
    groups=(
        families.point_group("platform joints", "the tool point", "da", [*A.values()]),
        PointGroup(
            "carriages",
            "the base's origin",
            tuple(((f"dq{i}", f"db{i}y", f"db{i}z"), B[i]) for i in LEGS),
        ),
    ),
)
