"""Cables that sag under their own weight: longer by w^2 L^3 cos^2(a) / (24 T^2).

It is the parabola that a catenary is at a small sag: w its weight a metre, T the tension,
a its angle from the horizontal. A steel rope of 2 mm weighs 0.16 N/m, one of 6 mm 1.4.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

WEIGHT_SQUARED = 0.16**2  # (N/m)^2, a steel rope of 2 mm


def columns(state: State) -> Iterable[Column]:
    """The length that sag takes up in each cable, of one weight."""
    rise = state.strut_direction[..., 2]
    level = (1.0 - rise**2) * state.strut_length**3 / 24.0
    change = state.joint_per_length * level * _inverse_square(state.tension)
    yield Column("cables", WEIGHT_SQUARED, "", terms.all_joints(change))


def _inverse_square(tension: Array) -> Array:
    """1 / T^2 (m, nq), 0 where no tension is known or a cable is slack."""
    is_taut = np.nan_to_num(tension) > 0.0
    return np.where(is_taut, 1.0 / np.where(is_taut, tension, 1.0) ** 2, 0.0)


effect = Effect(
    name="cable_sag",
    source="Irvine 1981, Cable Structures, MIT Press, section 2.3",
    about="cables that sag under their own weight",
    columns=columns,
    needs=("tension",),
    units={"*": "N2/m2"},
    remedy="pull the cables tighter, or state their weight in the controller's model",
    nature=natures.LOAD,
    exposed_by="the same poses at two pretensions, with the tensions recorded",
    unfit=terms.lacks_cables,
)
