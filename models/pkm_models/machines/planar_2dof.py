"""Planar manipulator with two sliders and two struts of fixed length: y and z of a
gantry's platform.

Chang, Li and Li (2011), Kinematic calibration and forecast error compensation of a
2-DOF planar parallel manipulator, Chinese Journal of Mechanical Engineering: section
2.2, Eqs. (2)-(3). Slider i runs on a guide through B_i = (-+D/2, 0), tilted by beta_i
from the vertical, and the strut hangs below it. With X = (y, z) the platform,

    |X - S_i| = l_i,        S_i = B_i + (q_i + z_i) (-sin beta_i, cos beta_i),

where q_i is what the scale shows and z_i its home error. The platform keeps its
orientation (parallelograms), so that the pose is a translation in the plane x = 0.

Tolerances: the paper gives none. These make a machine of the size of the one it started
from, whose deviations along horizontal lines were up to 1.6 mm in y and 1.7 mm in z.
"""

from collections.abc import Sequence

import casadi as ca

from oed.model import Expr, Parameter, Values
from pkm_models.machines.parts import translation
from pkm_models.machines.parts.coordinates import joint, point
from pkm_models.machines.parts.families import numbers
from pkm_models.machines.parts.translation import tool_point

LIMBS = (1, 2)
SIDE = {1: -0.5, 2: 0.5}
D = 3.584  # m, section 2.2
L = 3.350  # m, section 2.2
# Tolerances (prior standard deviations)
DISTANCE_SD = 0.5e-3  # m
HOME_SD = 0.5e-3  # m
LENGTH_SD = 0.5e-3  # m
TILT_SD = 0.3e-3  # rad


def _slider(i: int, q: Values, p: Values) -> Expr:
    travel = q[f"q{i}"] + p[f"z{i}"]
    tilt = p[f"beta{i}"]
    return ca.vertcat(
        0.0, SIDE[i] * p["D"] - travel * ca.sin(tilt), travel * ca.cos(tilt)
    )


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Strut lengths, m."""
    return [ca.norm_2(tool_point(x) - _slider(i, q, p)) - p[f"l{i}"] for i in LIMBS]


def guess(c: Values) -> tuple[Sequence[Expr], Sequence[Expr]]:
    """The commanded point, with the sliders where nominal struts would have them."""
    return [c["y"], c["z"]], [
        c["z"] + ca.sqrt(L**2 - (c["y"] - SIDE[i] * D) ** 2) for i in LIMBS
    ]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Guides from the table up to the sliders' highest place, and struts."""
    lines = []
    for i in LIMBS:
        ends = [_slider(i, {f"q{i}": height}, p) for height in (0.0, 5.0)]
        lines += [ends, [_slider(i, q, p), tool_point(x)]]
    return lines


machine = translation.machine(
    (0.0, 0.0),
    (point("y", -1.5, 1.5), point("z", 0.0, 1.5)),
    name="planar_2dof",
    source=(
        "Chang, Li and Li 2011, Chin. J. Mech. Eng., calibration of a 2-DOF planar"
        " parallel manipulator"
    ),
    about="planar manipulator (2-PRR with parallelograms): y, z driven",
    joints=tuple(
        joint(
            f"q{i}",
            "m",
            0.4,
            5.0,
            "height of slider {} on its guide, up, less its home error",
        )
        for i in LIMBS
    ),
    base_frame=(
        "origin on the table, midway between the guides; y horizontal, from guide 1 to"
        " guide 2; z up; the machine moves in the plane x = 0"
    ),
    parameters=(
        Parameter("D", D, DISTANCE_SD, "m", "distance between the guides at z = 0"),
        *numbers("z", [0.0] * 2, HOME_SD, "m", "home error of slider"),
        *numbers("l", [L] * 2, LENGTH_SD, "m", "length of strut"),
        *(
            Parameter(
                f"beta{i}", 0.0, TILT_SD, "rad", f"tilt of guide {i} from the vertical"
            )
            for i in LIMBS
        ),
    ),
    lever=1.0,
    closure=closure,
    guess=guess,
    skeleton=skeleton,
    struts=lambda x, q, p: [(_slider(i, q, p), tool_point(x)) for i in LIMBS],
)
