"""Numbers of readings written beside their places, so that none covers another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from oed.base.arrays import Array

#: where a number may stand about its place, in its own widths and heights
OFFSETS: Final = np.array(
    [
        [0, 0],
        [1, 0],
        [-1, 0],
        [0, 1],
        [0, -1],
        [1, 1],
        [-1, 1],
        [1, -1],
        [-1, -1],
    ],
    dtype=float,
)
#: numbers of readings written at one place
MOST_NUMBERS: Final = 3
LETTER_SIZE: Final = 5.5  # points
#: half-width of a label in letter sizes: of its frame, and of each letter
FRAME, LETTER = 0.45, 0.33
HALF_HEIGHT: Final = 0.8
#: distance of a label from its place, in half-widths and half-heights
DISTANCE: Final = 2.2
POINTS_PER_INCH: Final = 72.0


def write(
    axes: Axes, numbers: Mapping[tuple[float, float], Sequence[int]], colour: str
) -> None:
    """Mark each place and write its numbers; where there is no room, only the mark."""
    points = POINTS_PER_INCH / axes.figure.dpi
    corners = axes.bbox.get_points() * points
    taken: list[tuple[Array, Array]] = []
    for place, readings in numbers.items():
        axes.plot(
            *place,
            "o",
            color=colour,
            ms=2.4,
            zorder=2,
        )
        words = _joined(readings)
        half = LETTER_SIZE * np.array([FRAME + LETTER * len(words), HALF_HEIGHT])
        at = np.asarray(axes.transData.transform(place)) * points
        centre = _free_centre(at, half, corners, taken)
        if centre is not None:
            taken.append((centre, half))
            _annotate(axes, words, place, centre - at, colour)


def _joined(readings: Sequence[int]) -> str:
    """1 2 3, or 1 … 9 where they are many."""
    numbers = [str(n) for n in readings]
    if len(numbers) > MOST_NUMBERS:
        numbers = [numbers[0], "…", numbers[-1]]
    return " ".join(numbers)


def _free_centre(
    at: Array, half: Array, corners: Array, taken: Sequence[tuple[Array, Array]]
) -> Array | None:
    """The first centre about a place where a label covers no other, in points."""
    middle, room = corners.mean(axis=0), np.ptp(corners, axis=0) / 2.0
    for offset in OFFSETS:
        centre = at + DISTANCE * half * offset
        outside = offset.any() and (np.abs(centre - middle) > room).any()
        if not outside and not _covered(centre, half, taken):
            return np.asarray(centre)
    return None


def _covered(
    centre: Array,
    half: Array,
    taken: Sequence[tuple[Array, Array]],
) -> bool:
    return any(
        (np.abs(centre - other) < half + other_half).all()
        for other, other_half in taken
    )


def _annotate(
    axes: Axes, words: str, place: tuple[float, float], shift: Array, colour: str
) -> None:
    frame: Any = {
        "boxstyle": "round,pad=0.18",
        "fc": "white",
        "ec": colour,
        "lw": 0.7,
    }
    look: Any = {"fontsize": LETTER_SIZE, "annotation_clip": False, "zorder": 3}
    look |= {"ha": "center", "va": "center", "bbox": frame}
    offset: Any = tuple(shift)
    note = axes.annotate(words, place, offset, textcoords="offset points", **look)
    note.set_in_layout(False)
