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

from oed.model import Expr, Parameter, Start, Values
from pkm_models.machines import delta
from pkm_models.machines.delta import TOWERS
from pkm_models.machines.parts import families, translation
from pkm_models.machines.parts.coordinates import joint, point

RADIUS = 0.16175  # m
ARM = 0.345  # m
ENDSTOP = 0.420  # m
ANGLE = {1: math.radians(210.0), 2: math.radians(330.0), 3: math.radians(90.0)}


def by_tower(p: Values) -> dict[str, Expr]:
    """The numbers of a delta with upright towers, each `trim` farther out where it has one."""
    numbers = {}
    for i in TOWERS:
        numbers[f"radius{i}"] = p["radius"] + p.get(f"trim{i}", 0.0)
        numbers |= {f"{stem}{i}": 0.0 for stem in ("lean", "tip")}
        numbers |= {f"{s}{i}": p[f"{s}{i}"] for s in ("arm", "angle", "endstop")}
    return numbers


def guess(c: Values, p: Values) -> Start:
    """The commanded point, and each carriage at the upper end of its arm."""
    return delta.guess(c, by_tower(p))


machine = translation.machine(
    (0.0, 0.0, 0.020),
    (point("x", -0.140, 0.140), point("y", -0.140, 0.140), point("z", 0.0, 0.400)),
    name="linear_delta",
    source=(
        "delta printer kinematics; nominal numbers of the FLSun V400 (Klipper configuration, CC0)"
    ),
    about="linear delta (3-PUU with parallelograms): x, y, z driven",
    joints=tuple(joint(f"q{i}", "m", -0.05, 0.6, delta.DOWN) for i in TOWERS),
    base_frame=delta.BASE_FRAME,
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
    closure=lambda x, q, p: delta.closure(x, q, by_tower(p)),
    guess=guess,
    skeleton=lambda x, q, p: delta.skeleton(x, q, by_tower(p)),
    struts=lambda x, q, p: delta.struts(x, q, by_tower(p)),
    passive=lambda x, q, p: delta.passive_joints(x, q, by_tower(p)),
    frame=("angle3",),  # turning all towers together only turns the base frame
)
