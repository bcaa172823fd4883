"""A bar that warms up in the hand or the shop: it grows by R alpha dT(t) and so reads
that much less.

Its reading is the distance of the balls: a body longer by g than it is taken for tells
g less than there is.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references, terms

TEMPERATURE_RISE = 1.0  # K


def columns(state: State, tau: float, held: float) -> Iterable[Column]:
    """-R alpha dT(t) a bar: what follows the shop, or (held) the warmth of the hand
    that mounted it, which fades from the start of each set-up; shape: the other of the
    two, a second time constant, and any smooth course where no temperature is recorded.
    """
    measured, warm, second = terms.warm_up(state, "bar", tau)
    name = references.bar_label(state)
    long = references.bar_length(state) or references.NOMINAL_BAR_LENGTH
    unit, scale = (
        ("per kelvin", terms.STEEL_EXPANSION)
        if measured
        else ("rise", TEMPERATURE_RISE * terms.STEEL_EXPANSION)
    )
    hand = "held"
    most = TEMPERATURE_RISE * terms.STEEL_EXPANSION
    forms = {
        unit: (scale, warm),
        f"{unit} second": (terms.SHAPE_SHARE * scale, second),
        hand: (most, _fading(state, tau / 4.0)),
    }
    courses = {} if measured else terms.free_courses(state)
    forms |= {name: (terms.SHAPE_SHARE * most, form) for name, form in courses.items()}
    textbook = hand if held else unit
    for kind, (size, form) in forms.items():
        yield Column(
            f"{name} {kind}",
            size,
            reading={"length": -long * form},
            shape=kind != textbook,
        )


def _fading(state: State, tau: float) -> Array:
    """exp(-t / tau) since the set-up's first reading (m,); 0 where no time is known."""
    times = state.time[np.isfinite(state.time)]
    return (
        np.exp(-(terms.fill_gaps(state.time) - times.min()) / tau)
        if times.size
        else np.zeros(len(state))
    )


effect = Effect(
    name="bar_thermal",
    source="ISO 230-4 and ISO 1 (20 degrees C); steel 11.5e-6 / K",
    about="a bar that grows with its temperature",
    columns=columns,
    units={"*per kelvin*": "1/K", "*": "1"},
    needs=("time or temp_bar",),
    constants={"tau": terms.TIME_CONSTANTS, "held": (0.0, 1.0)},
    remedy=(
        "let the bar reach the shop's temperature, do not hold it in the hand, or"
        " correct by its sensor"
    ),
    nature=natures.SESSION,
    exposed_by="the bar zeroed again on its calibrator between runs",
)
