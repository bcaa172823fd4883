"""Friction that winds up the drive: a joint stays F / k(l) behind, in the sense in
which it moves.

Guides and seals take 20 to 100 N, drives give 20 to 100 N/um at the screw's middle,
less at its far end: 1 to 5 um (Altintas et al. 2011, CIRP Annals 60, 779-796, machine
tool feed drives).
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

WIND_UP = 4e-6  # m
#: speed up to which lubrication is mixed, over the session's largest feed: some 10 mm/s
#: (Armstrong-Helouvry et al. 1994, Automatica 30) of 2 m/min
STRIBECK = 0.3
#: joint travel over which a drive of that friction winds up after a reversal, m: on rolling elements 0.1
#: mm and less (Futami et al. 1990, Nanotechnology 1, 31), with seals and slack joints
#: more
WINDS_UP = (0.1e-3, 0.5e-3, 2e-3, 10e-3)


def columns(state: State, distance: float) -> Iterable[Column]:
    """-sense F / k(l) a leg, wound up anew after each reversal (Dahl 1968); shape:
    friction by load, more of it at low speed, and more along the travel.
    """
    unit, position, travel = (
        terms.joint_per_metre(state),
        terms.travel_position(state),
        terms.travel(state.machine),
    )
    screw = np.where(
        travel.guide.any(axis=1),
        1.0 + 0.5 * position,
        state.strut_length / travel.strut,
    )
    wound = state.motion_sign * (
        1.0 - 2.0 * np.exp(-state.travel_since_reversal / (distance * unit))
    )
    behind = -wound * unit * screw
    load = np.abs(state.tool_force * state.joint_per_length) * len(state.limbs) / 2.0
    slow = np.where(
        np.isfinite(state.rate),
        np.exp(-np.abs(terms.rate_share(state)) / STRIBECK),
        0.0,
    )
    forms = {"load": load, "slow": slow, "slope": position}
    shapes = {name: behind * form for name, form in forms.items()}
    return terms.by_leg(WIND_UP, behind, shapes)


effect = Effect(
    name="friction",
    source="Altintas et al. 2011, CIRP Annals 60, 779-796 (feed drives)",
    about="friction that winds up each drive, against its motion",
    columns=columns,
    needs=("direction: both",),
    constants={"distance": WINDS_UP},
    proportional={"distance": WIND_UP},
    remedy=(
        "lubricate, check the leg's seals and guides, close the loop by a linear"
        " encoder, or compensate friction"
    ),
    nature=natures.MOTION,
    family=natures.REVERSAL,
    exposed_by="circles in both directions at a slow feed, and with another load",
    unfit=terms.lacks_struts,
    common_to_limbs=True,
)
