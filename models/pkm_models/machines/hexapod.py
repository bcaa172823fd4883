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

from oed.model import Expr, Strut, Values
from pkm_models.machines.parts import families, legs, passive, six_dof
from pkm_models.machines.parts.coordinates import joint
from pkm_models.machines.parts.six_dof import command, target

LEGS = (1, 2, 3, 4, 5, 6)
BASE = 0.300  # m
PLATFORM = 0.200  # m
ABOVE = 0.100  # m
HEIGHT = 0.500  # m, tool point over the base at home
# Tolerances (prior standard deviations), m
JOINT_SD = 0.3e-3
ZERO_SD = 0.5e-3

#: joints in three pairs: at the base from its centre, at the platform from the tool point,
#: each 30 degrees outside its partner
B = dict(
    zip(
        LEGS,
        families.ring_points(BASE, (-15, 15, 105, 135, 225, 255), 0.0),
        strict=True,
    )
)
A = dict(
    zip(
        LEGS,
        families.ring_points(PLATFORM, (-45, 45, 75, 165, 195, 285), ABOVE),
        strict=True,
    )
)


def _joints(x: Values, p: Values) -> list[Strut]:
    """Joint centres B_i and A_i of each leg in the base frame."""
    return legs.drawn(x, p, [*B.values()], [*A.values()])


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Leg lengths; m."""
    return [
        ca.norm_2(a - b) - q[f"q{i}"] - p[f"dl{i}"]
        for i, (b, a) in zip(LEGS, _joints(x, p), strict=True)
    ]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Base, legs, platform, spindle."""
    feet, joints = zip(*_joints(x, p), strict=True)
    return legs.skeleton(feet, joints, x)


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
