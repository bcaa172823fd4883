"""Guideways that are not straight: a carriage is off its line by a smooth curve of its
travel, 10 um/m and more.

Only what displaces the carriage along its strut is seen: d l = along . shift. A
constant and a slope are geometry.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from oed.model import Machine
from pkm_models.effects import natures, terms

CURVE = 10e-6  # m, standard deviation along the travel


def columns(state: State) -> Iterable[Column]:
    """Towards and from the middle (radial) and across, a leg: modes of a smooth random
    curve over the travel, of which those after the first two let the form adapt.
    """
    guide = terms.travel(state.machine).guide
    position = terms.travel_position(state)
    out = terms.radial_directions(state)
    out = out - np.einsum("mjk,jk->mj", out, guide)[..., None] * guide
    out /= np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-9)
    for name, direction in (("radial", out), ("across", np.cross(guide, out))):
        change = terms.joint_change(state, direction)
        for i in state.limbs:
            for k in range(terms.N_CURVES):
                leg = f"leg {i + 1}"
                label = f"{leg} {name} curve {k + 1}"
                curve = {i: change[:, i] * terms.travel_curve(position[:, i], k)}
                yield Column(label, CURVE, leg, curve, shape=k > 1)


def unfit(machine: Machine) -> str | None:
    """Only machines whose joints move carriages have guideways."""
    reason = terms.lacks_struts(machine) or terms.has_rotary_drives(machine)
    if reason is None and not terms.travel(machine).guide.any():
        return "no joint moves the base end of its strut: it has no carriages"
    return reason


effect = Effect(
    name="guideway",
    source=(
        "ISO 230-1 (straightness); catalogues of rail guides: 5 to 20 um over a metre"
    ),
    about="carriages whose guideways are not straight",
    columns=columns,
    remedy="align the rails, or measure their straightness and correct it in the controller",
    nature=natures.TRAVEL,
    exposed_by="readings over the full stroke of each carriage",
    textbook_share=0.1,
    unfit=unfit,
)
