"""A certificate that is off: all lengths of a plate or step gauge in proportion.

Balls are certified farther apart than they are, or the plate has another temperature
than its certificate.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references

SCALE = 2e-6
INSTRUMENTS = ("ball_plate", "ball_distance")


def columns(state: State) -> Iterable[Column]:
    """The scale of each set-up's plate or gauge."""
    if state.instrument in INSTRUMENTS:
        block = references.block(state)
        yield Column(f"{block} scale", SCALE, block, reading=_change(state))


def _change(state: State) -> dict[str, Array]:
    """Change of the certified places of a plate, or of a distance, per unit of scale."""
    if state.instrument == "ball_distance":
        first = [references.from_reference(state, state.tool[:, k]) for k in range(3)]
        return {"length": np.linalg.norm(first, axis=0)}
    axis_by_channel = {f"ball_{n}": k for k, n in enumerate("xyz")}
    return {
        channel: state.tool[:, k] - state.settings[f"at_{'xyz'[k]}"]
        for channel, k in axis_by_channel.items()
    }


effect = Effect(
    name="plate_certificate",
    source=(
        "ISO 10360-2 and ISO 230-10 (certified artefacts): U = 0.5 um + L / 10^6; 0.2 K of"
        " steel 2.3e-6"
    ),
    about="a ball plate or step gauge whose certified lengths are off in proportion",
    columns=columns,
    units={"*": "1"},
    instruments=INSTRUMENTS,
    remedy="recalibrate the plate, and correct it to 20 degrees C by its own sensor",
    check="the certificate, its date and the plate's temperature",
    nature=natures.REFERENCE,
    exposed_by="a second artefact, or a laser interferometer, over the same distance",
)
