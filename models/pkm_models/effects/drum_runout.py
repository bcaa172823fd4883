"""Runout of a cable's drum or guide pulley: once a turn, a sin(2 pi L / c) + b cos.

A drum that is off its centre by e winds e sin of its angle more or less cable: 0.05 to
0.2 mm of turned drums. Circumferences are of usual diameters, 16 to 120 mm.
"""

import math
from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

ECCENTRICITY = 50e-6  # m
DIAMETERS_MM = (16, 20, 25, 30, 40, 50, 60, 80, 100, 120)
CIRCUMFERENCES = tuple(1e-3 * math.pi * diameter for diameter in DIAMETERS_MM)


def columns(state: State, circumference: float) -> Iterable[Column]:
    """Sine and cosine of the drum's angle a cable; shape: twice a turn."""
    angle = 2.0 * np.pi * state.strut_length / circumference
    return terms.turns(angle, state.joint_per_length, ECCENTRICITY)


effect = Effect(
    name="drum_runout",
    source="ISO 2768-1 (concentricity of turned parts), catalogues of winches",
    about="a drum or guide pulley of each cable that is off its centre",
    columns=columns,
    constants={"circumference": CIRCUMFERENCES},
    remedy="turn the drum between centres, or correct it by its index mark",
    nature=natures.TRAVEL,
    exposed_by="one cable paid out alone, in steps far smaller than a turn of its drum",
    unfit=terms.lacks_cables,
)
