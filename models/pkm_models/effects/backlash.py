"""Backlash: a joint stays b_i / 2 behind its command, in the sense in which it last
moved.

Ball screws without preload have 5 to 50 um of axial play, preloaded ones none to 5
(catalogues; ISO 230-2, reversal).
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

PLAY = 10e-6  # m
#: travel after a reversal over which such play is taken up, m: over more it is friction
#: that winds up
TAKEN_UP = (0.1e-3, 0.3e-3)


def columns(state: State, distance: float) -> Iterable[Column]:
    """-b sense / 2 a leg; shape: play that differs along the travel, and that is taken
    up after a reversal.
    """
    unit, position = terms.joint_per_metre(state), terms.travel_position(state)
    behind = -0.5 * state.motion_sign * unit
    fresh = np.exp(-state.travel_since_reversal / (distance * unit))
    forms = {"slope": position, "middle": position**2, "fresh": fresh}
    shapes = {name: behind * form for name, form in forms.items()}
    return terms.by_leg(PLAY, behind, shapes)


effect = Effect(
    name="backlash",
    source="ISO 230-2 (reversal value); catalogues of ball screws: 5 to 50 um without preload",
    about="play in each drive, taken up at each reversal of the joint",
    columns=columns,
    needs=("direction: both",),
    constants={"distance": TAKEN_UP},
    proportional={"distance": PLAY},
    remedy=(
        "preload or renew nuts and joints of the leg, or set the controller's backlash"
        " compensation a leg"
    ),
    nature=natures.MOTION,
    family=natures.REVERSAL,
    exposed_by="the same circle in both directions, at two feeds",
    common_to_limbs=True,
)
