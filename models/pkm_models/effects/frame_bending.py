"""A frame or an over-constrained linkage that bends: the tool is displaced by a smooth
field, beyond what is rigid.

It bends under what it carries: with a payload all of it grows, constant and linear
parts too, which are geometry where no payload changes. What is left of a 2-DOF machine
with struts of 3.35 m after its calibration is 50 to 70 um (Chang, Li and Li 2011).
"""

import itertools
from collections.abc import Iterable, Mapping

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

FIELD_SIZE = 20e-6  # m, at a lever's distance from the middle of the workspace
#: sizes of constant, linear, quadratic ... fields, against the quadratic one's
PARTS = (0.3, 0.3, 1.0, terms.SHAPE_SHARE, 0.5 * terms.SHAPE_SHARE)
SAGS = (0.15, 0.5)  #: payloads are a half to a seventh of what the frame carries anyhow


def columns(state: State, sag: float) -> Iterable[Column]:
    """Products of the reference tool point's coordinates displace the tool, all the
    more under payload; shape: all but quadratic ones, those of four only where it moves
    in a plane. Constant and linear ones are geometry but for what the payload adds.

    sag: how much more the frame bends under the session's heaviest payload than under
    none
    """
    offset = _offset(state)
    load = sag * terms.payload_share(state)
    for degree, part in enumerate(PARTS if len(offset) < 3 else PARTS[:4]):
        for name, field in _products(offset, degree):
            bent = field * (load if degree < 2 else 1.0 + load)
            for k, axis in enumerate("xyz"):
                label = f"{axis} by {name}" if name else axis
                yield Column(
                    label,
                    part * FIELD_SIZE,
                    "",
                    state.displacing_joints(k, bent),
                    shape=degree != 2,
                )


def _products(offset: Mapping[str, Array], degree: int) -> Iterable[tuple[str, Array]]:
    """Names and values (m,) of all products of so many coordinates; of none, 1."""
    for factors in itertools.combinations_with_replacement(offset, degree):
        yield (
            "".join(factors),
            np.asarray(np.prod([offset[f] for f in factors], axis=0)),
        )


def _offset(state: State) -> dict[str, Array]:
    """Coordinates (m,) of the reference tool point from mid workspace, in levers."""
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
    constants={"sag": SAGS},
    remedy=(
        "stiffen the frame, relieve the over-constraint, or correct by a measured grid"
        " with interpolation"
    ),
    nature=natures.LOAD,
    exposed_by="a dense grid of poses, read by a laser or tracker",
)
