"""A3 spindle head, a 3-RPS parallel mechanism: one translation and two rotations.

Tian et al. (2016), Kinematic calibration of a 3-DOF spindle head using a double ball
bar, Mechanism and Machine Theory 102, 167-178: Table 1, Eqs. (1)-(6), (16), (19). Limb
i is an extensible strut from the revolute joint B_i to the spherical joint A_i. The
closure is exact where the paper's Eq. (4) is linear: with v_i = A_i - B_i,

    |v_i| = q_i + dq_i,        v_i . s1_i = (q_i + dq_i) sin(beta_i).

The pose is the reference tool point, tilt (rx, ry) = theta (cos psi, sin psi) and spin
= psi + phi.
"""

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np

from oed.base import Orientation
from oed.model import Adjustment, Component, Coordinate, Expr, Parameter, Values
from pkm_models.machines.parts import coordinates, legs, passive, six_dof
from pkm_models.machines.parts.families import numbers, places, point_group

# m, Table 1
A = 0.250
B = 0.250
C = 0.526
D = 0.540
LIMBS = (1, 2, 3)
PHI = {i: 2.0 * math.pi * (i - 1) / 3.0 - math.pi / 2.0 for i in LIMBS}
XYZ = "xyz"

#: direction of the tool axis by psi and theta, and the paper's Euler angles z-x-z
AXIS = Orientation.direction(("z", "psi"), ("x", "theta"))
EULER = Orientation.rotation(("z", "psi"), ("x", "theta"), ("z", "phi"))
PSI = f"precession: direction of the axis about which the tool tilts, from x to y; {AXIS.formula}"
THETA = f"nutation: tilt of the tool axis from z; {AXIS.formula}"

# Tolerances (prior standard deviations): the size of the errors that Table 3 found on
# the prototype.
HOME_SD = 1.0e-3  # m
JOINT_SD = 1.0e-3  # m
TILT_SD = 10e-3  # rad

# Shims of 0.01 mm; under one of two bearings 200 mm apart they tilt a revolute joint.
SHIM = 0.01e-3  # m
TILT_STEP = 0.05e-3  # rad


def _base(i: int) -> tuple[float, float, float]:
    return (B * math.cos(PHI[i]), B * math.sin(PHI[i]), 0.0)


def _platform(i: int) -> tuple[float, float, float]:
    return (A * math.cos(PHI[i]), A * math.sin(PHI[i]), -C)


def _joints(x: Values, p: Values) -> list[tuple[Expr, Expr]]:
    """Joint centres B_i and A_i of each limb in the base frame."""
    return legs.drawn(x, p, [*map(_base, LIMBS)], [*map(_platform, LIMBS)])


def _hinge_axis(i: int) -> tuple[float, float, float]:
    return (-math.sin(PHI[i]), math.cos(PHI[i]), 0.0)


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Strut length and strut plane of each limb; lengths in m."""
    rows = []
    for i, (base, joint) in zip(LIMBS, _joints(x, p), strict=True):
        v, length = joint - base, q[f"q{i}"] + p[f"dq{i}"]
        s1 = ca.DM(_hinge_axis(i))
        rows += [ca.norm_2(v) - length, ca.dot(s1, v) - length * ca.sin(p[f"beta{i}"])]
    return rows


def target(c: Values) -> list[Expr]:
    """Height and tilt that the controller holds."""
    return [c["z"], c["theta"] * ca.cos(c["psi"]), c["theta"] * ca.sin(c["psi"])]


def guess(c: Values) -> tuple[Sequence[Expr], Sequence[Expr]]:
    """Upright start with the commanded tilt."""
    _, rx, ry = target(c)
    return [C * ca.sin(ry), -C * ca.sin(rx), c["z"], rx, ry, 0.0], [c["z"] - C] * 3


def read_error(c: Values, twist: Sequence[Expr]) -> list[Expr]:
    """x, y, z, Euler errors: d alpha = Psi (d psi, d theta, d phi) inverted, (19)."""
    cos_psi, sin_psi = ca.cos(c["psi"]), ca.sin(c["psi"])
    ax, ay, az = twist[3:]
    dtheta = cos_psi * ax + sin_psi * ay
    dphi = (sin_psi * ax - cos_psi * ay) / ca.sin(c["theta"])
    return [*twist[:3], az - ca.cos(c["theta"]) * dphi, dtheta, dphi]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Base triangle, limbs, platform triangle, spindle."""
    feet, joints = zip(*_joints(x, p), strict=True)
    return legs.skeleton(feet, joints, x)


def _parameters() -> tuple[Parameter, ...]:
    table = numbers("dq", [0.0] * len(LIMBS), HOME_SD, "m", "home error of limb")
    table += [
        Parameter(
            f"db{i}{k}",
            0.0,
            JOINT_SD,
            "m",
            f"{k} of base joint {i}",
            adjust=Adjustment(f"shift or shim base joint {i}", SHIM),
        )
        for i in LIMBS
        for k in XYZ
    ]
    table += places("da", np.zeros((len(LIMBS), 3)), JOINT_SD, "platform joint")
    table += [
        Parameter(
            f"beta{i}",
            0.0,
            TILT_SD,
            "rad",
            f"tilt of limb {i} out of its plane",
            adjust=Adjustment(f"shim under a bearing of base joint {i}", TILT_STEP),
        )
        for i in LIMBS
    ]
    return tuple(table)


machine = six_dof.driven(
    ("z", "psi", "theta"),
    name="a3_head",
    source="Tian et al. 2016, Mech. Mach. Theory 102, 167-178",
    about="A3 spindle head (3-RPS): z, psi, theta driven; x, y, phi parasitic",
    joints=tuple(
        coordinates.joint(
            f"q{i}", "m", 0.2, 1.2, "length of limb {} less its home error"
        )
        for i in LIMBS
    ),
    command=(
        coordinates.point("z", C + D, C + D + 0.200),
        Coordinate("psi", "rad", -2.0 * math.pi, 2.0 * math.pi, PSI),
        Coordinate("theta", "rad", 0.0, math.radians(40.0), THETA),
    ),
    base_frame=(
        "origin at the centre of the base joints; z square to them, towards the"
        " platform; joint 1 at -y, joints 2 and 3 at +x and -x"
    ),
    tool_axis="from the platform to the tool point, up at home",
    command_orientation=AXIS,
    parameters=_parameters(),
    components=(
        coordinates.point_error("x", driven=False),
        coordinates.point_error("y", driven=False),
        coordinates.point_error("z"),
        Component("psi", "rad", True, f"psi, actual less wanted; {EULER.formula}"),
        Component("theta", "rad", True, f"theta, actual less wanted; {EULER.formula}"),
        Component("phi", "rad", False, f"phi, actual less wanted; {EULER.formula}"),
    ),
    home={"z": C + D, "psi": 0.0, "theta": 0.0},
    lever=D,
    closure=closure,
    commanded=lambda x, tip: [tip[2], x["rx"], x["ry"]],
    target=target,
    guess=guess,
    read_error=read_error,
    skeleton=skeleton,
    struts=lambda x, q, p: _joints(x, p),
    passive=lambda x, q, p: passive.hinges(
        _joints(x, p), [_hinge_axis(i) for i in LIMBS], passive.UP
    ),
    frame=("db1x", "db2y", "db3y", "db1z", "db2z", "db3z"),  # Eq. (16)
    groups=(
        point_group("platform joints", "the TCP", "da", [*map(_platform, LIMBS)]),
        point_group("base joints", "the base centre", "db", [*map(_base, LIMBS)]),
    ),
)
