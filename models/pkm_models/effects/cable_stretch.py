"""Cables that stretch: a free length L0 under the tension T grows by c T L0, c = 1/(E A)
per newton. A steel rope of 2 mm has 5 ppm/N, a braided fibre of 1 mm 20 to 50 ppm/N.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

COMPLIANCE = 20e-6  # 1/N


def columns(state: State) -> Iterable[Column]:
    """c T_i L_i, one c for all cables of a robot, which are cut from one coil; shape:
    cables that differ.

    Lengths are those of the stretched cables: c T is small.
    """
    tension = np.nan_to_num(state.tension)
    change = state.joint_per_length * state.strut_length * tension
    return terms.alike("cables", COMPLIANCE, change)


effect = Effect(
    name="cable_stretch",
    source="Pott 2018, Cable-Driven Parallel Robots, Springer, section 4.2; rope catalogues",
    about="cables that stretch under their recorded tensions",
    columns=columns,
    units={"*": "1/N"},
    needs=("tension",),
    remedy="state the stiffness of the cables, and record their tensions, or take stiffer cables",
    nature=natures.LOAD,
    exposed_by="the same poses at two pretensions, with the tensions recorded",
    unfit=terms.lacks_cables,
    common_to_limbs=True,
)
