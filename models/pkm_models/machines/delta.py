"""Delta of any size and shape: radius, angle, tilt and carriage height of each tower.

Carriage i runs on a tower through the foot F_i = (R_i cos a_i, R_i sin a_i, 0), tilted
outward by lean_i and sideways, towards growing angles, by tip_i. At travel q_i down
from the endstop it is

    C_i = F_i + (endstop_i + sqrt(arm_i^2 - R_i^2) - q_i) u_i,
    u_i = (lean_i e_r + tip_i e_t + e_z) / norm,

with e_r and e_t radial and tangential, and the arm keeps |t - C_i| = arm_i with the
tool t below. R_i is the tower's distance less the platform's, endstop_i the height of
the tool at the endstop of an upright tower: the convention of Klipper, Marlin and
RepRapFirmware. All limbs hang below their carriages; a machine with a carriage below
the tool is in another assembly mode and refused.

Geometry (`[machine.geometry]`): radius, arm, angle, endstop, lean and tip, each one
number for all towers or one for each; print_radius and print_height, the workspace.
"""

import math
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import (
    Dimension,
    Expr,
    Family,
    Machine,
    Parameter,
    PassiveJoint,
    Start,
    Strut,
    Values,
)
from pkm_models.machines.parts import families, translation
from pkm_models.machines.parts.coordinates import joint, point
from pkm_models.machines.parts.families import Geometry, limb_rows
from pkm_models.machines.parts.translation import tool_point

TOWERS = (1, 2, 3)
DOWN = "travel of carriage {} down from its endstop"
BASE_FRAME = (
    "origin on the bed, midway between the towers; z up; towers at the angles from"
    " x to y that the parameters `angle` state"
)
NAME = "delta"
SOURCE = (
    "Klipper documentation, Delta calibration (convention of radius, arm, angle and"
    " endstop); Liu, Fang and others, error modelling of linear deltas, for the tilts"
)
ANGLES = tuple(math.radians(d) for d in (210.0, 330.0, 90.0))
#: radius of the workspace over the arm's horizontal reach, where none is given
PRINT_SHARE = 0.8
#: height of the workspace over the arm's vertical reach, where none is given
HEIGHT_SHARE = 0.6
ANGLE_SD = 3.5e-3  #: prior standard deviation of angles, rad
TILT_SD = 2e-3  #: prior standard deviation of tilts, rad

DIMENSIONS = (
    Dimension("radius", "m", (3,), 0.16175, "tower's distance less the platform's"),
    Dimension("arm", "m", (3,), 0.345, "arm lengths"),
    Dimension("angle", "rad", (3,), ANGLES, "angles of the towers"),
    Dimension("endstop", "m", (3,), None, "tool heights at the endstops"),
    Dimension("lean", "rad", (3,), 0.0, "tilts of the towers, outward"),
    Dimension("tip", "rad", (3,), 0.0, "tilts of the towers, sideways"),
    Dimension("print_radius", "m", (), None, "half the workspace's width"),
    Dimension("print_height", "m", (), None, "height of the workspace"),
    families.tolerance_dimension(),
)


def _tower(p: Values, i: int) -> tuple[Expr, Expr]:
    """Foot (3,) at z = 0 and direction (3,) of a tower."""
    angle = p[f"angle{i}"]
    cos, sin = ca.cos(angle), ca.sin(angle)
    lean, tip = p[f"lean{i}"], p[f"tip{i}"]
    axis = ca.vertcat(lean * cos - tip * sin, lean * sin + tip * cos, 1.0)
    foot = ca.vertcat(p[f"radius{i}"] * cos, p[f"radius{i}"] * sin, 0.0)
    return foot, axis / ca.norm_2(axis)


def _top(p: Values, i: int) -> Expr:
    """Carriage's place along its tower at q = 0, m."""
    return p[f"endstop{i}"] + ca.sqrt(p[f"arm{i}"] ** 2 - p[f"radius{i}"] ** 2)


def _carriage(i: int, q: Values, p: Values) -> Expr:
    foot, axis = _tower(p, i)
    return foot + (_top(p, i) - q[f"q{i}"]) * axis


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Arm lengths; m."""
    return [
        ca.norm_2(tool_point(x) - _carriage(i, q, p)) - p[f"arm{i}"] for i in TOWERS
    ]


def guess(c: Values, p: Values) -> Start:
    """The commanded point, and each carriage at the upper end of its arm."""
    joints = []
    for i in TOWERS:
        foot, axis = _tower(p, i)
        offset = tool_point(c) - foot
        along = ca.dot(offset, axis)
        across = ca.dot(offset, offset) - along**2
        above = ca.sqrt(p[f"arm{i}"] ** 2 - across)
        joints.append(_top(p, i) - along - above)
    return [c["x"], c["y"], c["z"]], joints


def struts(x: Values, q: Values, p: Values) -> list[Strut]:
    """Arms: carriage and tool."""
    return [(_carriage(i, q, p), tool_point(x)) for i in TOWERS]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Towers and arms."""
    lines = []
    for i in TOWERS:
        foot, axis = _tower(p, i)
        carriage = _carriage(i, q, p)
        lines += [[foot, foot + _top(p, i) * axis], [carriage, tool_point(x)]]
    return lines


def passive_joints(x: Values, q: Values, p: Values) -> list[PassiveJoint]:
    """Joints of the arms at the carriages: first axes across the towers' radii."""
    angles = [p[f"angle{i}"] for i in TOWERS]
    return translation.tangential_joints(struts(x, q, p), angles)


def build(geometry: Geometry) -> Machine:
    """A delta of this geometry. Raises ValueError where its arms are too short."""
    table = families.completed(DIMENSIONS, geometry)
    families.positive(table, "radius", "arm", "print_radius", "print_height")
    radius, arm = limb_rows(table["radius"], 3), limb_rows(table["arm"], 3)
    if not (arm > radius).all():
        raise ValueError(
            "an arm is shorter than its radius: it cannot reach the centre"
        )
    width, height, endstop = _workspace(table, radius, arm)
    size = float(arm.max())
    command = [point(n, -width, width) for n in "xy"]
    command.append(point("z", 0.0, height))
    travel = float(endstop.max()) + size
    return translation.machine(
        (0.0, 0.0, 0.05 * height),
        command,
        name=NAME,
        source=SOURCE,
        about="delta of any size: radius, angle, tilts and carriage height by tower",
        joints=tuple(joint(f"q{i}", "m", -size, travel, DOWN) for i in TOWERS),
        base_frame=BASE_FRAME,
        parameters=_parameters(table, radius, arm, endstop),
        lever=float(radius.mean()),
        closure=closure,
        guess=guess,
        skeleton=skeleton,
        struts=struts,
        passive=passive_joints,
        # Turning or tilting all towers together only turns the base frame.
        frame=("angle3",),
        family=family,
    )


def _workspace(
    table: Geometry, radius: Array, arm: Array
) -> tuple[float, float, Array]:
    """Half width and height of the workspace, and the endstops' heights (3,); m."""
    reach = float((arm - radius).min())
    width, height = table["print_radius"], table["print_height"]
    if width is None:
        # The corner of the square is nearer than the arm reaches, from every tower.
        width = PRINT_SHARE * min(reach, float(radius.min())) / math.sqrt(2.0)
    endstop = table["endstop"]
    if endstop is not None:
        endstop = limb_rows(endstop, 3)
        height = HEIGHT_SHARE * float(endstop.min()) if height is None else height
    else:
        height = HEIGHT_SHARE * 2.0 * float(arm.min()) if height is None else height
        endstop = limb_rows(height / HEIGHT_SHARE, 3)
    if not height > 0.0:
        raise ValueError("the endstops must be above z = 0, the plane of the bed")
    return float(width), float(height), endstop


def _parameters(
    table: Geometry, radius: Array, arm: Array, endstop: Array
) -> tuple[Parameter, ...]:
    sd = families.tolerance(table, float(np.mean(arm)))
    rows: list[tuple[str, Any, float, str, str]] = [
        ("radius", radius, sd, "m", "radius of tower"),
        ("arm", arm, sd, "m", "arm length of tower"),
        ("angle", table["angle"], ANGLE_SD, "rad", "angle of tower"),
        ("endstop", endstop, 1.5 * sd, "m", "tool height at endstop"),
        ("lean", table["lean"], TILT_SD, "rad", "outward tilt of tower"),
        ("tip", table["tip"], TILT_SD, "rad", "sideways tilt of tower"),
    ]
    return tuple(
        parameter
        for stem, values, spread, unit, about in rows
        for parameter in families.numbers(
            stem, limb_rows(values, 3).tolist(), spread, unit, about
        )
    )


family = Family(NAME, DIMENSIONS, build)
machine = build({})
