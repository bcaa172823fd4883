"""Lobing of a touch probe: its pre-travel depends on the direction of contact.

With phi the azimuth of the contact in the probe's own frame and s the sine of its angle
to the stylus, pre-travel varies as s^2 cos 2 phi and s^3 cos 3 phi, and as the sines: a
probe on a table touches along the base's z, one between two features along their line.
There one end is touched from each side, so that the second harmonic is read twice and
the third cancels.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references

LOBING = 1e-6  # m, in a lateral contact
HARMONICS = (2, 3)
PROBES = ("height_probe", "height_probe_tilted_bed", "contact_probe")


def columns(state: State) -> Iterable[Column]:
    """Both harmonics of each set-up's probe."""
    block = references.block(state)
    channel = "height" if state.instrument in PROBES else "length"
    for harmonic in HARMONICS if state.instrument in effect.instruments else ():
        wave = _contact(state) ** harmonic
        if channel == "length":
            wave = wave * (1.0 + (-1.0) ** harmonic)
        for name, form in (("cos", wave.real), ("sin", wave.imag)):
            yield Column(
                f"{block} {name} {harmonic}", LOBING, block, reading={channel: form}
            )


def _contact(state: State) -> Array:
    """s exp(i phi) (m,) of the contact in the platform's frame."""
    if state.instrument in PROBES:
        direction = np.tile([0.0, 0.0, 1.0], (len(state), 1))
    else:
        tool = state.tool.T
        line = np.array([references.from_reference(state, c) for c in tool])
        direction = (line / np.maximum(np.linalg.norm(line, axis=0), 1e-12)).T
    inside = np.einsum("mij,mi->mj", state.rotation, direction)
    return np.asarray(inside[:, 0] + 1j * inside[:, 1])


effect = Effect(
    name="probe_lobing",
    source=(
        "ISO 230-10 (probing performance of machine tools); data sheets of touch probes:"
        " pre-travel varies by 1 um"
    ),
    about="a touch probe whose pre-travel depends on the direction of contact",
    columns=columns,
    instruments=(*PROBES, "ball_distance"),
    remedy="map the pre-travel on a ring or sphere, or touch in one direction of the probe",
    check="the force of the probe's spring and its stylus",
    nature=natures.REFERENCE,
    exposed_by="the same features with the probe turned by 60 and by 90 degrees",
)
