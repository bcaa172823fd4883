"""Eccentric gear of a rotary drive: once a turn of a wheel, e / r sin(k q + phase).

DIN 3961 allows a runout F_r of 20 (class 6) to 40 um (class 8) at a reference diameter of
100 mm, which turns the joint by up to F_r / d. The output wheel turns with the joint, the
pinion as many times faster as the stage reduces.
"""

import math
from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from oed.model import Machine
from pkm_models.effects import natures, terms

#: amplitude, rad: 20 um of runout at a radius of 50 mm, half of it either way
ANGLE_AMPLITUDE = 2e-4
#: turns of a wheel a turn of the joint: the output wheel, and usual single stages
RATIOS = (1.0, 3.0, 5.0, 7.0, 10.0, 20.0, 30.0, 50.0, 100.0)


def columns(state: State, ratio: float) -> Iterable[Column]:
    """Sine and cosine of the wheel's angle a leg; shape: twice a turn."""
    return terms.harmonics(state, 2.0 * math.pi / ratio, ANGLE_AMPLITUDE)


def unfit(machine: Machine) -> str | None:
    """Only drives that turn their joints have gears at them."""
    has_cables = machine.cable_stiffness is not None
    is_rotary = terms.has_rotary_drives(machine) is not None and not has_cables
    if is_rotary and machine.drive in ("", "gear", "belt"):
        return None
    return "no gear turns its joints"


effect = Effect(
    name="gear_eccentricity",
    source="DIN 3961 (runout of cylindrical gears), classes 6 to 8",
    about="an eccentric wheel of each joint's gear, once a turn of the wheel",
    columns=columns,
    constants={"ratio": RATIOS},
    of_drive="ratio",
    units={"*": "rad"},
    remedy="renew or centre the wheel, or correct the joint by an encoder at its output",
    nature=natures.TRAVEL,
    exposed_by="one joint turned alone, in steps far smaller than a turn of the wheel",
    unfit=unfit,
)
