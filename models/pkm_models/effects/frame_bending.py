"""A frame or an over-constrained linkage that bends: a smooth field of the pose in each leg, beyond what is rigid.

Constant and linear parts are geometry; what is left of a 2-DOF machine with struts of 3.35 m after its calibration is
50 to 70 um (Chang, Li and Li 2011).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.batch import Array
from oed.effect import Column, Effect, State
from pkm_models.effects import terms

FIELD = 20e-6  # m, at a lever's distance from the middle of the workspace


def columns(state: State) -> Iterable[Column]:
    """Products of the reference tool point's coordinates towards the leg (r), across it (t) and upwards (z)."""
    offset, out = _offset(state), terms.radial(state)
    r = np.einsum("mjk,mk->mj", out, offset)
    t = out[..., 0] * offset[:, 1:2] - out[..., 1] * offset[:, :1]
    z, unit = offset[:, 2:], terms.metre(state)
    plain = {"rr": r * r, "rz": r * z, "zz": z * z}
    adapting = {"tt": t * t, "rrr": r**3, "rrz": r * r * z, "rzz": r * z * z}
    for name, field in (plain | adapting).items():
        shape = name in adapting
        change = unit * field
        for i in state.limbs:
            scale = terms.ADAPT * FIELD if shape else FIELD
            yield Column(f"leg {i + 1} {name}", scale, f"leg {i + 1}", {i: change[:, i]}, shape=shape)


def _offset(state: State) -> Array:
    """Reference tool point (m, 3) from the middle of the workspace, in levers."""
    middle = {c.name: 0.5 * (c.lower + c.upper) for c in state.machine.command}
    offset = np.zeros((len(state), 3))
    for k, c in enumerate(state.machine.pose):
        if c.name in ("x", "y", "z"):
            offset[:, "xyz".index(c.name)] = state.pose[:, k] - middle.get(c.name, 0.0)
    return offset / state.machine.lever


effect = Effect(
    name="frame_bending",
    source="Chang, Li and Li 2011, Chin. J. Mech. Eng.: what calibration left, by over-constraint",
    about="a frame or over-constrained linkage that bends with the pose",
    columns=columns,
    remedy="stiffen the frame, relieve the over-constraint, or correct by a measured grid with interpolation",
    exposed_by="a dense grid of poses, read by a laser or tracker",
    unfit=terms.no_struts,
)
