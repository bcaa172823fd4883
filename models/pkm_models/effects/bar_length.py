"""A bar that is not as long as it says: a constant in its readings. Calibrators leave 1
um, an unzeroed bar 10 um.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references

LENGTH_ERROR = 10e-6  # m


def columns(state: State) -> Iterable[Column]:
    """A constant a bar: what reads too much is shorter than it says."""
    yield Column(
        references.bar_label(state),
        LENGTH_ERROR,
        references.block(state),
        reading={"length": np.ones(len(state))},
    )


effect = Effect(
    name="bar_length",
    source="ISO 230-4 (ball bars); data sheets of calibrators: 0.5 to 1 um",
    about="a bar (or calliper) whose zero is wrong",
    columns=columns,
    remedy="calibrate the bar (or calliper) on a certified length before use",
    check="the certified length, and whether it is this bar's",
    nature=natures.SCALE,
    exposed_by=(
        "a second known tool length, a second bar calibrated apart, or a laser interferometer"
    ),
)
