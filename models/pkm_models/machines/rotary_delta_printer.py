"""Rotary delta printer over its bed, in the numbers of its firmware.

Limb i stands at the angle a_i from x to y. Its upper arm turns about a level axis at `radius`
and `height` over the bed, both less the effector's; t_i is its angle over the horizontal,
outward. Joint q_i turns it down from its switch, and |tool - k_i| = lower_i with the knee

    k_i = radius + upper_i cos t_i along a_i, height + upper_i sin t_i up,  t_i = endstop_i - q_i.

All knees are outward, as in rotary_delta.py of Klipper and RotaryDeltaKinematics of
RepRapFirmware. One radius moves all shoulders, and an angle turns the axis with its shoulder:
the family `rotary_delta` has each shoulder's place and axis as numbers of their own.
"""

import math
from collections.abc import Sequence

import casadi as ca

from oed.model import Expr, Parameter, Strut, Values
from pkm_models.machines.parts import families, translation
from pkm_models.machines.parts.coordinates import joint, point

LIMBS = (1, 2, 3)
DOWN = "turn of upper arm {} down from its switch"
#: those of Klipper's example, m and rad; switches where the tool is 252 mm over the bed
RADIUS = 0.0339
HEIGHT = 0.4129
UPPER = 0.170
LOWER = 0.320
ANGLES = tuple(math.radians(d) for d in (30.0, 150.0, 270.0))
ENDSTOP = 0.7734
ANGLE_SD = 3.5e-3  # rad: limbs are mounted within 0.2 degrees
ENDSTOP_SD = 20e-3  # rad: switches are set by eye within a degree
LENGTH_SD = 1e-3  # m


def _limb(x: Values, q: Values, p: Values, i: int) -> list[Expr]:
    """Shoulder, knee and tool (3,)."""
    turn = p[f"endstop{i}"] - q[f"q{i}"]
    angle = p[f"angle{i}"]
    outward = ca.vertcat(ca.cos(angle), ca.sin(angle), 0.0)
    shoulder = p["radius"] * outward + ca.vertcat(0.0, 0.0, p["height"])
    arm = ca.cos(turn) * outward + ca.vertcat(0.0, 0.0, ca.sin(turn))
    return [shoulder, shoulder + p[f"upper{i}"] * arm, translation.tool_point(x)]


def _struts(x: Values, q: Values, p: Values) -> list[Strut]:
    """Lower arms, from knee to tool."""
    limbs = [_limb(x, q, p, i) for i in LIMBS]
    return [(knee, tool) for _, knee, tool in limbs]


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Lengths of the lower arms; m."""
    struts = zip(LIMBS, _struts(x, q, p), strict=True)
    return [ca.norm_2(tool - knee) - p[f"lower{i}"] for i, (knee, tool) in struts]


def guess(c: Values, p: Values) -> tuple[Sequence[Expr], Sequence[Expr]]:
    """The commanded point, and upper arms, knees outward, by the law of cosines."""
    joints = []
    for i in LIMBS:
        cos, sin = ca.cos(p[f"angle{i}"]), ca.sin(p[f"angle{i}"])
        outward = c["x"] * cos + c["y"] * sin - p["radius"]
        across, up = c["y"] * cos - c["x"] * sin, c["z"] - p["height"]
        square = outward**2 + up**2
        sides = square + p[f"upper{i}"] ** 2 + across**2 - p[f"lower{i}"] ** 2
        turn = ca.acos(sides / (2.0 * p[f"upper{i}"] * ca.sqrt(square)))
        joints.append(p[f"endstop{i}"] - ca.atan2(up, outward) - turn)
    return [c["x"], c["y"], c["z"]], joints


machine = translation.machine(
    (0.0, 0.0, 0.020),
    (point("x", -0.080, 0.080), point("y", -0.080, 0.080), point("z", 0.0, 0.200)),
    name="rotary_delta_printer",
    source="Klipper, klippy/kinematics/rotary_delta.py; RepRapFirmware, RotaryDeltaKinematics.cpp",
    about="rotary delta printer in its firmware's numbers: x, y, z driven",
    joints=tuple(joint(f"q{i}", "rad", -math.pi, math.pi, DOWN) for i in LIMBS),
    base_frame=(
        "origin on the bed, midway between the shoulders; z up; limbs at the angles from"
        " x to y that the parameters `angle` state"
    ),
    parameters=(
        Parameter(
            "radius", RADIUS, LENGTH_SD, "m", "shoulders' radius less effector's"
        ),
        Parameter("height", HEIGHT, LENGTH_SD, "m", "shoulders over bed less effector"),
        *families.numbers("angle", list(ANGLES), ANGLE_SD, "rad", "angle of limb"),
        *families.numbers("upper", [UPPER] * 3, LENGTH_SD, "m", "length of upper arm"),
        *families.numbers("lower", [LOWER] * 3, LENGTH_SD, "m", "length of lower arm"),
        *families.numbers(
            "endstop", [ENDSTOP] * 3, ENDSTOP_SD, "rad", "angle at the switch of arm"
        ),
    ),
    lever=UPPER,
    closure=closure,
    guess=guess,
    skeleton=lambda x, q, p: [_limb(x, q, p, i) for i in LIMBS],
    struts=_struts,
    frame=("angle3",),  # turning all limbs together only turns the base frame
)
