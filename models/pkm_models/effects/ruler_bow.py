"""A straightedge, or the blade of a square, that is bent: what is read across it bends.

A bow over the whole length reads h (1 - u^2) with u from -1 to 1 along it; a run's
first pose, against which it is read, takes its own value away.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references, terms

BOW = 5e-6  # m, in its middle


def columns(state: State) -> Iterable[Column]:
    """The bow of each set-up's straightedge; shape: an S about it."""
    if state.instrument not in references.LINES:
        return
    axis, channel = references.LINES[state.instrument]
    u = references.line_places(state, axis)
    yield _column(state, channel, "bow", BOW, 1.0 - u**2)
    s_shape = (u - u**3) * 1.5 * np.sqrt(3.0)
    yield _column(state, channel, "S", terms.SHAPE_SHARE * BOW, s_shape)


def _column(state: State, channel: str, name: str, scale: float, form: Array) -> Column:
    block = references.block(state)
    return Column(
        f"{block} {name}",
        scale,
        block,
        reading={channel: references.from_reference(state, form)},
        shape=name != "bow",
    )


effect = Effect(
    name="ruler_bow",
    source="ISO 230-1 (straightness by a straightedge); certificates: some micrometres on a metre",
    about="a straightedge or square whose edge is bent along its length",
    columns=columns,
    instruments=tuple(references.LINES),
    textbook_share=0.8,
    remedy=(
        "reverse the ruler and take the mean of both readings, subtract its certificate,"
        " or measure another line"
    ),
    check="how the ruler is supported, and its certificate",
    nature=natures.REFERENCE,
    exposed_by="the same line with the ruler reversed, or shifted along itself",
)
