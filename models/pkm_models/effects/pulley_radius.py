"""Guide pulleys of finite radius: a cable that turns by an angle winds r times it.

A model takes the cable for straight from where it comes up the post. Over a pulley of
radius r, whose housing follows the cable, its free part begins at the tangent point. With
g the angle between the vertical and the cable it is, to first order in r, longer by
r (g - sin g): the arc, less what the pulley's middle is nearer.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

#: m, of what a controller leaves: ball bearings used as guides have 5 to 20 mm
RADIUS = 1e-3


def columns(state: State) -> Iterable[Column]:
    """r (g - sin g) of one radius; shape: a cable that comes from elsewhere, whose arc
    differs by the angle, and a radius each.
    """
    angle = np.arccos(np.clip(state.strut_direction[..., 2], -1.0, 1.0))
    worth = state.joint_per_length
    turned = terms.all_joints(worth * angle)
    yield from terms.alike("pulleys", RADIUS, worth * (angle - np.sin(angle)))
    yield terms.adapting("pulleys, arc", RADIUS, "", turned)


effect = Effect(
    name="pulley_radius",
    source="Pott 2018, Cable-Driven Parallel Robots, Springer, section 7.2",
    about="guide pulleys whose radius the controller does not know",
    columns=columns,
    remedy="state the pulleys' radius in the controller's model, or fit eyelets",
    nature=natures.TRAVEL,
    exposed_by="poses at which each cable leaves its guide steeply and flat",
    unfit=terms.lacks_cables,
    common_to_limbs=True,
)
