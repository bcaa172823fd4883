"""A frame or an over-constrained linkage that bends: the tool is displaced by a smooth field, beyond what is rigid.

Constant and linear parts are geometry; what is left of a 2-DOF machine with struts of 3.35 m after its calibration is
50 to 70 um (Chang, Li and Li 2011).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping

import numpy as np

from oed.batch import Array
from oed.effect import Column, Effect, State
from pkm_models.effects import terms

FIELD = 20e-6  # m, at a lever's distance from the middle of the workspace


def columns(state: State) -> Iterable[Column]:
    """Products of the reference tool point's coordinates displace the tool; shape: cubic ones, those of four where it
    moves in a plane, and what comes with the payload."""
    offset, load = _offset(state), terms.carried(state) - 0.5
    small = terms.ADAPT * FIELD
    for degree, scale in ((2, FIELD), (3, small), (4, small)):
        for name, field in _products(offset, degree) if degree < 4 or len(offset) < 3 else ():
            yield from _displaced(state, name, scale, field, shape=degree > 2)
    for degree in (0, 1, 2):
        for name, field in _products(offset, degree):
            yield from _displaced(state, f"payload {name}".strip(), small, load * field, shape=True)


def _displaced(state: State, name: str, scale: float, field: Array, *, shape: bool) -> Iterable[Column]:
    for k, axis in enumerate("xyz"):
        yield Column(f"{axis} by {name}", scale, "", state.displaced(k, field), shape=shape)


def _products(offset: Mapping[str, Array], degree: int) -> Iterable[tuple[str, Array]]:
    """Names and values (m,) of all products of so many coordinates; of none, 1."""
    for factors in itertools.combinations_with_replacement(offset, degree):
        yield "".join(factors), np.asarray(np.prod([offset[f] for f in factors], axis=0))


def _offset(state: State) -> dict[str, Array]:
    """Coordinates (m,) of the reference tool point from the middle of the workspace, in levers, by their names."""
    middle = {c.name: 0.5 * (c.lower + c.upper) for c in state.machine.command}
    return {
        c.name: (state.pose[:, k] - middle.get(c.name, 0.0)) / state.machine.lever
        for k, c in enumerate(state.machine.pose)
        if c.name in ("x", "y", "z")
    }


effect = Effect(
    name="frame_bending",
    source="Chang, Li and Li 2011, Chin. J. Mech. Eng.: what calibration left, by over-constraint",
    about="a frame or over-constrained linkage that bends with the pose",
    columns=columns,
    remedy="stiffen the frame, relieve the over-constraint, or correct by a measured grid with interpolation",
    exposed_by="a dense grid of poses, read by a laser or tracker",
)
