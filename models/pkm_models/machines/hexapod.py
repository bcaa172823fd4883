"""Hexapod: a platform on six extensible legs (6-UPS, Gough-Stewart), all six
coordinates driven.

Leg i runs from the base joint B_i to the platform joint A_i:

    |x + R A_i - B_i| = q_i + dl_i.

42 parameters: base joints (18), platform joints (18), leg zeros (6), as in J. Wang and
O. Masory, On the accuracy of a Stewart platform, IEEE ICRA 1993, 114-120. The geometry
is a generic 6-6 one chosen here: base joints on a circle of 300 mm in pairs 30 degrees
apart, platform joints on one of 200 mm in pairs 30 degrees apart over the base's gaps;
their plane is 600 mm above the base at home and 100 mm above the tool point.
Tolerances: joints 0.3 mm, legs' zeros 0.5 mm. No parameter is held: a pose read in a
known frame sees the base joints' common place, which a free frame would hide.
"""

import math

import casadi as ca
import numpy as np

from oed.model import Expr, Values
from pkm_models.machines.parts import families, passive, six_dof
from pkm_models.machines.parts.coordinates import joint
from pkm_models.machines.parts.six_dof import XYZ, command, platform, target

LEGS = (1, 2, 3, 4, 5, 6)
BASE = 0.300  # m
PLATFORM = 0.200  # m
ABOVE = 0.100  # m
HEIGHT = 0.500  # m, tool point over the base at home
# Tolerances (prior standard deviations), m
JOINT_SD = 0.3e-3
ZERO_SD = 0.5e-3
Point = tuple[float, float, float]


def _ring(radius: float, half: float, height: float) -> dict[int, Point]:
    """Joints in three pairs, `half` degrees on either side of 0, 120, 240 degrees."""
    angle = {
        i: math.radians(120.0 * ((i - 1) // 2) + (half if i % 2 == 0 else -half))
        for i in LEGS
    }
    return {
        i: (radius * math.cos(a), radius * math.sin(a), height)
        for i, a in angle.items()
    }


B = _ring(BASE, 15.0, 0.0)  # base joints, from the base centre
A = _ring(
    PLATFORM, 45.0, ABOVE
)  # platform joints, from the tool point: each 30 degrees outside its partner


def _joints(x: Values, p: Values) -> list[tuple[Expr, Expr]]:
    """Joint centres B_i and A_i of each leg in the base frame."""
    rotation, point = platform(x)
    joints = []
    for i in LEGS:
        foot = [n + p[f"db{i}{k}"] for n, k in zip(B[i], XYZ, strict=True)]
        local = [n + p[f"da{i}{k}"] for n, k in zip(A[i], XYZ, strict=True)]
        joints.append((ca.vertcat(*foot), point + rotation @ ca.vertcat(*local)))
    return joints


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Leg lengths; m."""
    return [
        ca.norm_2(a - b) - q[f"q{i}"] - p[f"dl{i}"]
        for i, (b, a) in zip(LEGS, _joints(x, p), strict=True)
    ]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Base, legs, platform, spindle."""
    feet, joints = zip(*_joints(x, p), strict=True)
    legs = [[b, a] for b, a in zip(feet, joints, strict=True)]
    return [
        [*feet, feet[0]],
        *legs,
        [*joints, joints[0]],
        [sum(joints[1:], joints[0]) / 6.0, platform(x)[1]],
    ]


machine = six_dof.machine(
    name="hexapod",
    source=(
        "Wang and Masory 1993, IEEE ICRA, 114-120, for the 42 parameters; a generic 6-6 geometry"
    ),
    about="hexapod (6-UPS): x, y, z, tilt and spin driven",
    joints=tuple(
        joint(f"q{i}", "m", 0.350, 0.900, "length of leg {} less its zero")
        for i in LEGS
    ),
    command=command((0.0, 0.0, HEIGHT), 0.100, math.radians(15.0)),
    base_frame=(
        "origin at the centre of the base joints; z square to them, towards the"
        " platform; x between the joints of legs 1 and 2"
    ),
    tool_axis="from the tool point to the platform, up at home",
    parameters=(
        *families.places("db", np.zeros((6, 3)), JOINT_SD, "base joint"),
        *families.places("da", np.zeros((6, 3)), JOINT_SD, "platform joint"),
        *families.numbers("dl", [0.0] * 6, ZERO_SD, "m", "zero of leg"),
    ),
    home={"x": 0.0, "y": 0.0, "z": HEIGHT, "rx": 0.0, "ry": 0.0, "spin": 0.0},
    lever=PLATFORM,
    closure=closure,
    guess=lambda c: (target(c), [c["z"] + ABOVE] * 6),
    skeleton=skeleton,
    struts=lambda x, q, p: _joints(x, p),
    passive=lambda x, q, p: passive.universals(
        _joints(x, p), passive.tangents(np.array(list(B.values()))), passive.UP
    ),
    groups=(
        families.point_group("platform joints", "the tool point", "da", [*A.values()]),
        families.point_group("base joints", "the base centre", "db", [*B.values()]),
    ),
)
