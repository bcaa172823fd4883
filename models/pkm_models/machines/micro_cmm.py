"""Micro-CMM: three extensible legs hang a platform below a frame; it only translates.

A. Rugbani and K. Schreve, The use of parallel mechanism micro-CMM in micrometrology,
Eqs. (1)-(5): leg i runs from the frame point f_i (radius R_f, angle theta_f) to the
platform point p_i (radius R_p, angle theta_p), so that

    |x - (f_i - p_i)| = q_i + dl_i,      f_i = R_f (cos theta_f, sin theta_f, 0),  p_i
                                         alike.

x is the probe, below the frame: z < 0. The paper gives no dimensions: R_f = 200 mm, R_p
= 60 mm and a probe 150 to 250 mm below the frame are chosen here; a study replaces them
by [machine.nominal]. So are the tolerances: parts made to 50 um, and the legs' zeros as
well. The paper's joints are spherical at both ends; those alone do not keep the
platform parallel, so take Tsai's 3-UPU legs (its Fig. 2). Its closed forms (6)-(8), in
the text that we have, do not solve (3)-(5): see docs/errata.md, and `direct` for forms
that do.
"""

import math

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Expr, PassiveJoint, Values
from pkm_models.machines.parts import translation
from pkm_models.machines.parts.coordinates import joint, point
from pkm_models.machines.parts.families import numbers
from pkm_models.machines.parts.translation import tool_point

LEGS = (1, 2, 3)
R_FRAME = 0.200  # m
R_PLATFORM = 0.060  # m
ANGLE = {i: 2.0 * math.pi * (i - 1) / 3.0 for i in LEGS}
MANUFACTURING_SD = 50e-6  # m


def direct(lengths: Array, rho: float = R_FRAME - R_PLATFORM) -> Array:
    """Probe (..., 3) at leg lengths (..., 3) of the perfect machine, rho = R_f - R_p:
    Eqs. (3)-(5) solved, all in m.

    Differences of (3)-(5) are linear in x and y; z is the root below the frame.
    """
    l1, l2, l3 = np.moveaxis(np.asarray(lengths, dtype=float), -1, 0)
    x = (l2**2 + l3**2 - 2.0 * l1**2) / (6.0 * rho)
    y = (l3**2 - l2**2) / (2.0 * math.sqrt(3.0) * rho)
    z = -np.sqrt(l1**2 - (x - rho) ** 2 - y**2)
    return np.stack([x, y, z], axis=-1)


def _point(radius: Expr, angle: Expr) -> Expr:
    return ca.vertcat(radius * ca.cos(angle), radius * ca.sin(angle), 0.0)


def _ends(x: Values, p: Values, i: int) -> tuple[Expr, Expr]:
    """Frame point f_i and platform point x + p_i."""
    return _point(p[f"rf{i}"], p[f"thetaf{i}"]), tool_point(x) + _point(
        p[f"rp{i}"], p[f"thetap{i}"]
    )


def closure(x: Values, q: Values, p: Values) -> list[Expr]:
    """Leg lengths, Eqs. (3)-(5); m."""
    ends = [_ends(x, p, i) for i in LEGS]
    return [
        ca.norm_2(b - a) - q[f"q{i}"] - p[f"dl{i}"]
        for i, (a, b) in zip(LEGS, ends, strict=True)
    ]


def skeleton(x: Values, q: Values, p: Values) -> list[list[Expr]]:
    """Frame, legs, platform, probe."""
    frame, platform = zip(*[_ends(x, p, i) for i in LEGS], strict=True)
    legs = [[a, b] for a, b in zip(frame, platform, strict=True)]
    return [
        [*frame, frame[0]],
        *legs,
        [*platform, platform[0]],
        *[[b, tool_point(x)] for b in platform],
    ]


def passive_joints(x: Values, q: Values, p: Values) -> list[PassiveJoint]:
    """Universal joints at the frame: first axes tangential, at the frame points' angles."""
    struts = [_ends(x, p, i) for i in LEGS]
    return translation.tangential_joints(struts, [p[f"thetaf{i}"] for i in LEGS])


machine = translation.machine(
    (0.0, 0.0, -0.200),
    (point("x", -0.040, 0.040), point("y", -0.040, 0.040), point("z", -0.250, -0.150)),
    name="micro_cmm",
    source=(
        "Rugbani and Schreve, The use of parallel mechanism micro-CMM in"
        " micrometrology, Eqs. (1)-(5)"
    ),
    about="micro-CMM with three extensible legs (3-UPU): x, y, z driven",
    joints=tuple(
        joint(f"q{i}", "m", 0.120, 0.350, "length of leg {} less its zero")
        for i in LEGS
    ),
    base_frame=(
        "origin at the centre of the upper frame; z square to it, away from the probe;"
        " x towards leg 1"
    ),
    parameters=(
        *numbers("rf", [R_FRAME] * 3, MANUFACTURING_SD, "m", "radius of frame point"),
        *numbers(
            "rp", [R_PLATFORM] * 3, MANUFACTURING_SD, "m", "radius of platform point"
        ),
        *numbers(
            "thetaf",
            list(ANGLE.values()),
            MANUFACTURING_SD / R_FRAME,
            "rad",
            "angle of frame point",
        ),
        *numbers(
            "thetap",
            list(ANGLE.values()),
            MANUFACTURING_SD / R_PLATFORM,
            "rad",
            "angle of platform point",
        ),
        *numbers("dl", [0.0] * 3, MANUFACTURING_SD, "m", "zero of leg"),
    ),
    lever=R_FRAME,
    closure=closure,
    guess=lambda c: (
        [c["x"], c["y"], c["z"]],
        [ca.norm_2(ca.vertcat(R_FRAME - R_PLATFORM, c["z"]))] * 3,
    ),
    skeleton=skeleton,
    struts=lambda x, q, p: [_ends(x, p, i) for i in LEGS],
    passive=passive_joints,
)
