"""Refraction of air: the wavelength of a laser, and so all its lengths, with the weather.

By Edlen's equation lengths read too short by 0.93 ppm a kelvin of air that is warmer than
stated, and too long by 0.27 ppm an hPa of higher pressure. What a set-up has throughout is
a scale; where the air's temperature is recorded, a compensation that does not follow
it is a second one.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references, terms

PER_KELVIN = 0.93e-6  #: change of a length by the air's temperature, 1 / K
PER_HPA = 0.27e-6  #: change of a length by the air's pressure, 1 / hPa
#: air that is not as it was stated: 1 K and 3 hPa
SCALE = float(np.hypot(PER_KELVIN, 3.0 * PER_HPA))
#: channels along the beam of interferometers
BEAMS = {"rm1": {"dy": 1}, "rm2": {"dz": 2}, "rm5": {"dy": 1}}


def columns(state: State) -> Iterable[Column]:
    """The scale of each set-up's lengths, and that per kelvin where it is recorded."""
    if state.instrument not in effect.instruments:
        return
    block, lengths = references.block(state), _lengths(state)
    yield Column(f"{block} scale", SCALE, block, reading=lengths)
    measured, rise, _ = terms.warm_up(state, "air", terms.TIME_CONSTANTS[0])
    if measured:
        with_air = {channel: length * rise for channel, length in lengths.items()}
        yield Column(f"{block} per kelvin", PER_KELVIN, block, reading=with_air)


def _lengths(state: State) -> dict[str, Array]:
    """Lengths (m,) that the laser reads in each channel, from its station or reference."""
    if state.instrument in BEAMS:
        return {
            channel: references.from_reference(state, state.tool[:, k])
            for channel, k in BEAMS[state.instrument].items()
        }
    station = [state.settings.get(f"at_{n}", 0.0) for n in "xyz"]
    return {f"read_{n}": state.tool[:, k] - station[k] for k, n in enumerate("xyz")}


effect = Effect(
    name="air_refraction",
    source=(
        "ISO 230-1 and JCGM 100 (GUM) practice; Edlen: 0.93 ppm / K and 0.27 ppm / hPa of air"
    ),
    about="a laser whose wavelength is not corrected for the air",
    columns=columns,
    units={"*per kelvin": "1/K", "*": "1"},
    instruments=(*BEAMS, *references.STATIONS),
    remedy="measure temperature and pressure of the air in the beam, and correct by them",
    check="the weather station, and what was typed in for it",
    nature=natures.REFERENCE,
    exposed_by="a material standard, such as a gauge, over the same distance",
)
