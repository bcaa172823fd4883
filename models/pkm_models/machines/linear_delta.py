"""Linear delta: three vertical carriages, three parallelogram arms, a platform that
only translates.

The geometry of delta printers (FLSun V400 size by default): carriage i runs on a
vertical tower at radius R and angle alpha_i, its height is endstop_i + sqrt(arm_i^2 -
R^2) - q_i, where q_i is the travel down from the endstop and endstop_i the tool height
at which the endstop triggers. The arm keeps tool and carriage at distance arm_i:

    |t - (R cos alpha_i, R sin alpha_i, h_i)| = arm_i,

and the tool is the lower of the two points that satisfy it.
"""

import math
from collections.abc import Sequence

import casadi as ca

from oed.model import Expr, Parameter, PassiveJoint, Values
from pkm_models.machines.parts import families, translation
from pkm_models.machines.parts.coordinates import joint, point
from pkm_models.machines.parts.translation import tool_point

TOWERS = (1, 2, 3)
DOWN = "travel of carriage {} down from its endstop"
RADIUS = 0.16175  # m
ARM = 0.345  # m
ENDSTOP = 0.420  # m
ANGLE = {1: math.radians(210.0), 2: math.radians(330.0), 3: math.radians(90.0)}


def _carriage(i: int, q: Values, p: Values) -> Expr:
    """Position (3,) of the carriage's arm joint, reduced by the platform's radius."""
    radius, arm, angle = p["radius"], p[f"arm{i}"], p[f"angle{i}"]
    height = p[f"endstop{i}"] + ca.sqrt(arm**2 - radius**2) - q[f"q{i}"]
    return ca.vertcat(radius * ca.cos(angle), radius * ca.sin(angle), height)


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Arm lengths; m."""
    return [
        ca.norm_2(tool_point(x) - _carriage(i, q, p)) - p[f"arm{i}"] for i in TOWERS
    ]


def guess(c: Values, p: Values) -> tuple[Sequence[Expr], Sequence[Expr]]:
    """The commanded point, and each carriage at the upper end of its arm."""
    joints = []
    for i in TOWERS:
        lowered = _carriage(i, {f"q{i}": 0.0}, p)
        across = (c["x"] - lowered[0]) ** 2 + (c["y"] - lowered[1]) ** 2
        joints.append(lowered[2] - c["z"] - ca.sqrt(p[f"arm{i}"] ** 2 - across))
    return [c["x"], c["y"], c["z"]], joints


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Towers and arms."""
    lines = []
    for i in TOWERS:
        top = _carriage(i, q, p)
        foot = ca.vertcat(top[0], top[1], 0.0)
        head = ca.vertcat(top[0], top[1], ENDSTOP + math.sqrt(ARM**2 - RADIUS**2))
        lines += [[foot, head], [top, tool_point(x)]]
    return lines


def passive_joints(x: Values, q: Values, p: Values) -> list[PassiveJoint]:
    """Joints of the arms at the carriages: first axes across the towers' radii."""
    struts = [(_carriage(i, q, p), tool_point(x)) for i in TOWERS]
    return translation.tangential_joints(struts, [p[f"angle{i}"] for i in TOWERS])


machine = translation.machine(
    (0.0, 0.0, 0.020),
    (point("x", -0.140, 0.140), point("y", -0.140, 0.140), point("z", 0.0, 0.400)),
    name="linear_delta",
    source=(
        "delta printer kinematics; nominal numbers of the FLSun V400 (Klipper configuration, CC0)"
    ),
    about="linear delta (3-PUU with parallelograms): x, y, z driven",
    joints=tuple(joint(f"q{i}", "m", -0.05, 0.6, DOWN) for i in TOWERS),
    base_frame=(
        "origin on the bed, midway between the towers; z up; towers at the angles from"
        " x to y that the parameters `angle` state"
    ),
    parameters=(
        Parameter("radius", RADIUS, 0.5e-3, "m", "tower circle less platform radius"),
        *families.numbers("arm", [ARM] * 3, 1.0e-3, "m", "arm length of tower"),
        *families.numbers(
            "angle", list(ANGLE.values()), 3.5e-3, "rad", "angle of tower"
        ),
        *families.numbers(
            "endstop", [ENDSTOP] * 3, 1.5e-3, "m", "tool height at endstop"
        ),
    ),
    lever=RADIUS,
    closure=closure,
    guess=guess,
    skeleton=skeleton,
    struts=lambda x, q, p: [(_carriage(i, q, p), tool_point(x)) for i in TOWERS],
    passive=passive_joints,
    frame=("angle3",),  # turning all towers together only turns the base frame
)
