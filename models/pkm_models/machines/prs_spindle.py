"""3-PRS spindle head: three vertical sliders, three struts of fixed length; z and the
tilts alpha, beta driven.

Wang and Fan (2004), Identification of strut and assembly errors of a 3-PRS
serial-parallel machine tool, International Journal of Machine Tools and Manufacture 44,
1171-1178: Table 1, Eqs. (1), (3)-(6), (15). Slider i carries a revolute joint R_i =
(R_iX, R_iY, q_i), whose axis s_i is tangential, and a strut of length l_i leads from it
to the ball joint b_i of the platform. With P the tool tip and v_i = P + [R] b_i - R_i,

    |v_i| = l_i,        v_i . s_i = 0,        s_i = (-sin phi_i, cos phi_i, 0).

The second row, the plane in which the revolute joint holds the strut, is missing from
the paper's model of the errors (see `prs_spindle_struts`). Joints stand at phi_i = 0,
120, 240 deg on circles about the machine's axis, as in Table 1; Eq. (2) has its origin
elsewhere. The 18 parameters are those of Table 4: db1x is
its Delta b_1x, dR1x its Delta R_1X (base frame), dl1 its Delta l_1. Heights of the
sliders are what the scales show.

The spindle axis is n = (sin beta, -sin alpha cos beta, cos alpha cos beta), and [R] =
Rx(alpha) Ry(beta) Rz(gamma). The paper prints no heights; a z that moves all sliders
together changes nothing of the geometry.
"""

import math
from collections.abc import Sequence

import casadi as ca

from oed.base import Orientation
from oed.model import (
    Adjustment,
    Component,
    Coordinate,
    Expr,
    Parameter,
    PointGroup,
    Values,
)
from pkm_models.machines.parts import coordinates, legs, passive, six_dof
from pkm_models.machines.parts.families import point_group, shifted
from pkm_models.machines.parts.six_dof import platform

# m, Table 1
R = 0.349  # circle of the sliders
RADIUS = 0.200  # circle of the ball joints
H = 0.340722  # height of the ball joints
L = 1.107  # struts
LIMBS = (1, 2, 3)
PHI = {i: 2.0 * math.pi * (i - 1) / 3.0 for i in LIMBS}
TILT = math.radians(35.0)

#: direction of the spindle axis, Eq. (15), and the angles of the rotation [R]
AXIS = Orientation.direction(("x", "alpha"), ("y", "beta"))
ANGLES = Orientation.rotation(("x", "alpha"), ("y", "beta"), ("z", "gamma"))

# Tolerances (prior standard deviations): the size of the errors that Table 4 found,
# column by column.
SLIDER_SD = 1.0e-3  # m
BALL_SD = 0.2e-3  # m
LENGTH_SD = 0.5e-3  # m

# Section 6: "the joint position errors have to be corrected by manual reassembly of
# column positions"; strut lengths are programmed.
COLUMN_STEP = 0.01e-3  # m, thinnest shim


def _circle(radius: float, height: float, i: int) -> tuple[float, float, float]:
    return (radius * math.cos(PHI[i]), radius * math.sin(PHI[i]), height)


def joints(x: Values, q: Values, p: Values, i: int) -> tuple[Expr, Expr]:
    """Slider joint R_i and ball joint b_i in the base frame."""
    foot = shifted(_circle(R, 0.0, i)[:2], p, f"dR{i}", "xy")
    local = shifted(_circle(RADIUS, H, i), p, f"db{i}")
    rotation, point = platform(x)
    return ca.vertcat(*foot, q[f"q{i}"]), point + rotation @ ca.vertcat(*local)


def plane_distance(x: Values, q: Values, p: Values, i: int) -> Expr:
    """v_i . s_i: how far the ball joint is beside the plane of its strut, m."""
    slider, ball = joints(x, q, p, i)
    return ca.dot(ca.DM(_hinge_axis(i)), ball - slider)


def _hinge_axis(i: int) -> tuple[float, float, float]:
    return (-math.sin(PHI[i]), math.cos(PHI[i]), 0.0)


def strut(x: Values, q: Values, p: Values, i: int) -> Expr:
    """|v_i| - l_i, m."""
    slider, ball = joints(x, q, p, i)
    return ca.norm_2(ball - slider) - L - p[f"dl{i}"]


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Strut length and strut plane of each limb, m."""
    return [row(x, q, p, i) for i in LIMBS for row in (strut, plane_distance)]


def target(c: Values) -> list[Expr]:
    """Height of the tool tip; x and y of the spindle axis, Eq. (15)."""
    return [c["z"], ca.sin(c["beta"]), -ca.sin(c["alpha"]) * ca.cos(c["beta"])]


def guess(c: Values) -> tuple[Sequence[Expr], Sequence[Expr]]:
    """Platform centre on the machine's axis, ball joints lifted by the tilt."""
    z, nx, ny = target(c)
    lift = [
        z + H + RADIUS * (ca.sin(c["alpha"]) * math.sin(PHI[i]) - nx * math.cos(PHI[i]))
        for i in LIMBS
    ]
    return [-H * nx, -H * ny, z, -ny, nx, 0.0], [
        v + math.sqrt(L**2 - (R - RADIUS) ** 2) for v in lift
    ]


def read_error(c: Values, twist: Sequence[Expr]) -> list[Expr]:
    """x, y, z and alpha, beta, gamma: rotation vector = d alpha e_x + d beta Rx(alpha)
    e_y + d gamma n, inverted.
    """
    cos_a, sin_a = ca.cos(c["alpha"]), ca.sin(c["alpha"])
    wx, wy, wz = twist[3:]
    gamma = (cos_a * wz - sin_a * wy) / ca.cos(c["beta"])
    return [*twist[:3], wx - ca.sin(c["beta"]) * gamma, cos_a * wy + sin_a * wz, gamma]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Guides, struts, platform, spindle."""
    sliders, balls = zip(*[joints(x, q, p, i) for i in LIMBS], strict=True)
    columns = [
        [ca.vertcat(s[0], s[1], height) for height in (1.1, 2.1)] for s in sliders
    ]
    return [*columns, *legs.skeleton(sliders, balls, x)[1:]]


def _parameters(i: int) -> list[Parameter]:
    table = [
        Parameter(
            f"db{i}{k}", 0.0, BALL_SD, "m", f"{k} of ball joint {i}, platform frame"
        )
        for k in "xyz"
    ]
    table += [
        Parameter(
            f"dR{i}{k}",
            0.0,
            SLIDER_SD,
            "m",
            f"{k} of slider joint {i}, base frame",
            adjust=Adjustment(f"move column {i}", COLUMN_STEP),
        )
        for k in "xy"
    ]
    return [*table, Parameter(f"dl{i}", 0.0, LENGTH_SD, "m", f"length of strut {i}")]


_BALLS = [_circle(RADIUS, H, i) for i in LIMBS]
_SLIDERS = tuple(
    ((f"dR{i}x", f"dR{i}y", ""), _circle(R, 0.0, i)) for i in LIMBS
)  # heights are no parameters

machine = six_dof.driven(
    ("z", "alpha", "beta"),
    name="prs_spindle",
    source="Wang and Fan 2004, Int. J. Mach. Tools Manuf. 44, 1171-1178",
    about=(
        "3-PRS spindle head, full closure: z, alpha, beta driven; x, y, gamma parasitic"
    ),
    joints=tuple(
        coordinates.joint(f"q{i}", "m", 1.1, 2.1, "height of slider {}, up")
        for i in LIMBS
    ),
    command=(
        coordinates.point("z", 0.0, 0.400),
        Coordinate("alpha", "rad", -TILT, TILT, f"about x; {AXIS.formula}"),
        Coordinate("beta", "rad", -TILT, TILT, f"about the turned y; {AXIS.formula}"),
    ),
    base_frame=(
        "origin on the machine's axis, midway between the sliders' guides; z up along"
        " them; x towards slider 1"
    ),
    tool_axis="from the tool tip into the spindle, up at home",
    command_orientation=AXIS,
    parameters=tuple(p for i in LIMBS for p in _parameters(i)),
    components=tuple(coordinates.point_error(n, driven=n == "z") for n in "xyz")
    + tuple(
        Component(n, "rad", n != "gamma", f"{n}, actual less wanted; {ANGLES.formula}")
        for n in ("alpha", "beta", "gamma")
    ),
    home={"z": 0.200, "alpha": 0.0, "beta": 0.0},
    lever=H,
    closure=closure,
    commanded=lambda x, tip: [tip[2], *[platform(x)[0][k, 2] for k in (0, 1)]],
    target=target,
    guess=guess,
    read_error=read_error,
    skeleton=skeleton,
    struts=lambda x, q, p: [joints(x, q, p, i) for i in LIMBS],
    passive=lambda x, q, p: passive.hinges(
        [joints(x, q, p, i) for i in LIMBS],
        [_hinge_axis(i) for i in LIMBS],
        passive.DOWN,
    ),
    groups=(
        point_group("platform joints", "the tool tip", "db", _BALLS),
        PointGroup("slider joints", "the machine's axis", _SLIDERS),
    ),
)
