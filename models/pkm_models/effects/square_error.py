"""A square that is not square: the line it stands for is turned against the other one.

What is read across the blade changes by the angle times the way along it. A set-up
whose direction of the square is unknown anyhow has this error in its `tilt`.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references

ANGLE = 10e-6  # rad
INSTRUMENTS = ("rm4",)


def columns(state: State) -> Iterable[Column]:
    """The angle of each set-up's square."""
    if state.instrument in INSTRUMENTS:
        block = references.block(state)
        one = np.ones(len(state))
        yield Column(f"{block} angle", ANGLE, block, nuisances={"tilt": one})


effect = Effect(
    name="square_error",
    source="ISO 230-1 (squareness by a square); certificates: 5 to 10 um on a metre",
    about="a square whose two directions are not perpendicular",
    columns=columns,
    units={"*": "rad"},
    instruments=INSTRUMENTS,
    remedy="read with the square reversed and take the mean, or subtract its certified angle",
    check="the square's certificate, and how it lies on its base",
    nature=natures.REFERENCE,
    exposed_by="the same line with the square reversed",
)
