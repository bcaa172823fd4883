"""Clearance of the joints: a strut is delta / 2 longer under tension, and shorter under
pressure, than it is adjusted.

Fitted ball joints have 5 to 20 um. While no leg's load changes its sign this is the
leg's zero, and is not seen.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

PLAY = 10e-6  # m
#: share of the load within which a joint is not yet at its stop
SOFT = (0.01, 0.05, 0.2)


def columns(state: State, ratio: float, soft: float) -> Iterable[Column]:
    """delta tanh(leg force / its soft share) / 2 a leg; shape: another stop, and play
    that differs along the travel of a leg whose load changes its sign: what is always
    taken up is a leg's zero and scale.
    """
    pull = terms.joint_load(state, ratio)[0] * state.joint_per_length
    half = 0.5 * state.joint_per_length
    side = np.tanh(pull / soft)
    shapes = {
        "harder": half * np.tanh(pull / (0.3 * soft)),
        "slope": half * terms.travel_position(state) * (side - side.mean(axis=0)),
    }
    return terms.by_leg(PLAY, half * side, shapes)


effect = Effect(
    name="joint_clearance",
    source="catalogues of rod ends and spherical joints: internal clearance 5 to 20 um",
    about="play of the joints at a leg's ends, taken up by the sign of its load",
    columns=columns,
    constants={"ratio": terms.MASS_RATIOS, "soft": SOFT},
    remedy="preload or renew the joints of the leg",
    nature=natures.LOAD,
    exposed_by=(
        "pull and push at the platform, at poses where a leg's load changes its sign"
    ),
    unfit=terms.lacks_jointed_struts,
    common_to_limbs=True,
)
