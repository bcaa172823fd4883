"""What effects on the references of set-ups need: blocks, and places along a line."""

import numpy as np

from oed.base import Array
from oed.effect_model import State

#: instruments that read across a straightedge or a square: its direction (base axis) and
#: the channel that it errs in
LINES = {"rm3": (1, "dz"), "rm4": (2, "dy"), "rm5": (1, "dz")}
#: instruments that read points about the place where they stand
STATIONS = (
    "pose_tracker",
    "pose_tracker_position",
    "laser_ball_bar",
    "laser_ball_bar_position",
)
#: probes that read heights, along z of the base frame
HEIGHT_PROBES = (
    "height_probe",
    "height_probe_tilted_bed",
    "contact_probe",
    "length_gauge",
)


def block(state: State) -> str:
    """The place of a set-up's own error."""
    return f"set-up {state.setup}"


def line_places(state: State, axis: int) -> Array:
    """Places (m,), -1 to 1, along a straightedge as long as its set-up's way."""
    coordinate = state.tool[:, axis]
    low, high = coordinate.min(), coordinate.max()
    return np.asarray(2.0 * (coordinate - low) / max(high - low, 1e-12) - 1.0)


def from_reference(state: State, values: Array) -> Array:
    """Values (m,) less that at the first pose of their run, which reads 0."""
    relative = values.copy()
    for run in dict.fromkeys(state.run):
        members = np.flatnonzero(state.run == run)
        first = members[np.argmin(state.order[members])]
        relative[members] -= values[first]
    return relative


NOMINAL_BAR_LENGTH = 0.3  # m, where a set-up does not tell


def bar_length(state: State) -> float | None:
    """Nominal length of the set-up's bar, m; None where it does not tell."""
    length = state.settings.get("length")
    return None if length is None else float(length)


def bar_label(state: State) -> str:
    """The bar by its length, or by its set-up: bars of one nominal length are one bar."""
    length = bar_length(state)
    return f"{state.setup} bar" if length is None else f"bar {1e3 * length:g} mm"
