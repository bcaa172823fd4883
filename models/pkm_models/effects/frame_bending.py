"""A frame or an over-constrained linkage that bends: the tool is displaced by a smooth field, beyond what is rigid.

Constant and linear parts are geometry; what is left of a 2-DOF machine with struts of 3.35 m after its calibration is
50 to 70 um (Chang, Li and Li 2011).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from oed.batch import Array
from oed.effect import Column, Effect, State
from pkm_models.effects import terms

FIELD = 20e-6  # m, at a lever's distance from the middle of the workspace


def columns(state: State) -> Iterable[Column]:
    """Products of the reference tool point's coordinates displace the tool; shape: cubic ones, and by payload."""
    offset, load = _offset(state), _load(state)
    for degree, scale in ((2, FIELD), (3, terms.ADAPT * FIELD)):
        for factors in itertools.combinations_with_replacement(range(3), degree):
            field = offset[:, factors].prod(axis=1)
            for k, axis in enumerate("xyz"):
                name = f"{axis} by {''.join('xyz'[f] for f in factors)}"
                yield Column(name, scale, "", state.displaced(k, field), shape=degree > 2)
    for degree in (0, 1, 2):
        for factors in itertools.combinations_with_replacement(range(3), degree):
            field = load * offset[:, factors].prod(axis=1)
            for k, axis in enumerate("xyz"):
                name = f"{axis} by payload {''.join('xyz'[f] for f in factors)}".strip()
                yield Column(name, terms.ADAPT * FIELD, "", state.displaced(k, field), shape=True)


def _load(state: State) -> Array:
    """Payload (m,) as a share of the session's heaviest, beyond its mean; zeros where it does not change."""
    share = np.nan_to_num(state.payload) / state.heaviest if state.heaviest > 0.0 else np.zeros(len(state))
    return np.asarray(share - 0.5)


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
)
