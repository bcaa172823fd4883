"""Runout of the joints: a centre that wanders as its joint turns, e_i times harmonics
of the joint's angle.

Once a turn is a displaced centre, which is geometry; what is left is twice a turn and
faster. Ball joints are round to 1 to 5 um, and the amplitude of a lobe falls with the
number of lobes; rings of bearings, with 8 to 16 rolling bodies, are wavy by some tenths.
"""

import itertools
from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

RUNOUT = 4e-6  # m
SLIGHT = terms.SHAPE_SHARE  # of runout
#: harmonics of the joint's angle that its centre wanders by along the leg, and their
#: share of runout: twice a turn first, once what the geometry leaves of it
RUNOUT_BY_ORDER = {2: 1.0, 1: SLIGHT} | {
    order: 2.0 / order for order in (*range(3, 13), 16)
}
#: and sideways, where only the slow ones show
SIDEWAYS = {1: SLIGHT, 2: 1.0, 3: SLIGHT}


def columns(state: State, platform: float, across: float) -> Iterable[Column]:
    """Twice a turn, along the leg, of the joint at the base (0) or the platform (1), as
    the leg swings in its plane (0) or across it (1); shape: once, three times and
    faster, and sideways to the swing. None at the platform of a machine that does not
    turn it.
    """
    frame = _platform(state) if platform else _base(state)
    if frame is None:
        return
    away, up = frame
    sideways = np.cross(up, away)
    way, aside = (sideways, away) if across else (away, sideways)
    angle = np.arctan2(
        *(np.einsum("mjk,mjk->mj", state.strut_direction, axis) for axis in (way, up))
    )
    ways = {
        "": (state.joint_per_length, RUNOUT_BY_ORDER),
        "sideways ": (terms.joint_change(state, aside), SIDEWAYS),
    }
    for i, (kind, (amount, shares)) in itertools.product(state.limbs, ways.items()):
        leg = f"leg {i + 1}"
        for order, part_of in shares.items():
            for part, value in (
                ("sin", np.sin(order * angle[:, i])),
                ("cos", np.cos(order * angle[:, i])),
            ):
                change = {i: amount[:, i] * value}
                name = f"{leg} {kind}{order} {part}"
                scale = part_of * RUNOUT
                yield Column(name, scale, leg, change, shape=bool(kind) or order != 2)


def _base(state: State) -> tuple[Array, Array]:
    """Unit vectors (m, nq, 3) at the base: away from the machine's middle, and up."""
    away = terms.radial_directions(state)
    return away, np.broadcast_to(np.array([0.0, 0.0, 1.0]), away.shape)


def _platform(state: State) -> tuple[Array, Array] | None:
    """Unit vectors (m, nq, 3) at the platform: away from its middle, and its normal."""
    if not any(c.unit == "rad" for c in state.machine.pose) or len(state.limbs) < 3:
        return None
    away = state.platform - state.platform.mean(axis=1, keepdims=True)
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    normal = np.cross(away[:, 0], away[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return away, np.broadcast_to(normal[:, None], away.shape)


effect = Effect(
    name="joint_runout",
    source=(
        "ISO 230-7 (axes of rotation); catalogues of precision ball joints: sphericity 1 to 5 um"
    ),
    about="joint centres that wander as their joints turn",
    columns=columns,
    constants={"platform": (0.0, 1.0), "across": (0.0, 1.0)},
    remedy="measure the joints' runout on a bench, and renew or map those that wander",
    nature=natures.TRAVEL,
    exposed_by="large tilts in all directions",
    textbook_share=0.1,
    unfit=terms.lacks_jointed_struts,
)
