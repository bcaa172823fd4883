"""The path through the poses in working order, a panel for each set-up."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from oed import units
from oed.base import Array, Index
from oed.result import PlannedReading
from pkm_reports import missing, style, text

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
#: a full turn, degrees
FULL_TURN: Final = 360.0
MOST_PANELS: Final = 12
#: readings from which the lines of the path are faint
MANY: Final = 100
#: what counts as one step of a coordinate, by its SI unit
STEP_IN_UNIT: Final = {"m": "mm", "rad": "deg"}


@dataclasses.dataclass(frozen=True, slots=True)
class Plane:
    """The two coordinates that the figure shows.

    names     of the coordinates; "reading" is the number of the reading
    at        place of each reading (n, 2)
    turn      full turn (2,) of coordinates that go round, infinite for others
    limits    lower and upper limit (2, 2)
    """

    names: tuple[str, str]
    at: Array
    turn: Array
    limits: Array


def draw(poses: Sequence[PlannedReading]) -> Figure:
    """Readings by their numbers in working order, joined by lines."""
    plane = choose_plane(poses)
    if plane is None:
        return style.empty("No commanded poses are stored in this result.")
    setups = list(dict.fromkeys(pose.setup for pose in poses))[:MOST_PANELS]
    groups = [
        np.flatnonzero([pose.setup == setup for pose in poses]) for setup in setups
    ]
    columns = 1 if len(setups) == 1 else 2
    rows = math.ceil(len(setups) / columns)
    figure = style.figure(0.2 + (3.2 if columns == 1 else 2.35) * rows)
    shared: Any = {"sharex": True, "sharey": True}
    grid = figure.subplots(
        rows,
        columns,
        squeeze=False,
        **shared,
    ).ravel()
    for k, (axes, setup, group) in enumerate(zip(grid, setups, groups, strict=False)):
        _panel(axes, plane, group, style.CYCLE[k % len(style.CYCLE)])
        axes.tick_params(labelbottom=k + columns >= len(setups))
        number = "" if len(setups) == 1 else f"{k + 1}: "
        readings = text.count(len(group), "reading")
        axes.set_title(f"{number}{style.label(setup)}, {readings}")
    style.hide(grid[len(setups) :])
    figure.supxlabel(style.label(text.heading(plane.names[0])), fontsize=8)
    figure.supylabel(style.label(text.heading(plane.names[1])), fontsize=8)
    figure.draw_without_rendering()  # numbers need the panels' final size
    for k, (axes, group) in enumerate(zip(grid, groups, strict=False)):
        numbers = _numbers_by_place(plane, group)
        write(axes, numbers, style.CYCLE[k % len(style.CYCLE)])
    return figure


def coordinates(poses: Sequence[PlannedReading]) -> list[str]:
    """Commanded coordinates of the poses, in order of appearance."""
    return list(dict.fromkeys(name for pose in poses for name in pose.command))


def choose_plane(poses: Sequence[PlannedReading]) -> Plane | None:
    """The two coordinates that vary most, 1 mm counted as 1 degree.

    Where only one varies, the other is the number of the reading.
    """
    names = coordinates(poses)
    table: dict[str, Array] = {}
    for name in names:
        values = missing.column([pose.command for pose in poses], name)
        if np.isfinite(values).any():
            table[name] = values
    if not table:
        return None
    spread = {
        name: np.ptp(values[np.isfinite(values)]) / _step(name)
        for name, values in table.items()
    }
    widest = sorted(table, key=lambda name: -spread[name])[:2]
    if len(widest) == 1 or spread[widest[1]] == 0.0:
        table["reading"] = np.arange(1.0, len(poses) + 1.0)
        first, second = "reading", widest[0]
    else:
        first, second = sorted(widest, key=names.index)
    return _plane((first, second), np.column_stack([table[first], table[second]]))


def _plane(names: tuple[str, str], points: Array) -> Plane:
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    span = high - low
    turn = np.array([_full_turn(name) for name in names])
    turn[(span <= FULL_TURN / 2.0) | (span > FULL_TURN)] = np.inf
    # A coordinate that goes round is shown over one full turn.
    around = (FULL_TURN - span) / 2.0
    margin = np.where(span > 0.0, 0.07 * span, 1.0)
    room = np.where(np.isfinite(turn), around, margin)
    return Plane(names, points, turn, np.array([low - room, high + room]))


def _full_turn(name: str) -> float:
    return FULL_TURN if text.split_unit(name)[1] == "deg" else math.inf


def _step(name: str) -> float:
    """What counts as one step of a coordinate, in its own unit: 1 mm, 1 degree."""
    unit = text.split_unit(name)[1]
    if not unit:
        return 1.0
    kind = units.si_unit(unit)
    step = units.factor(STEP_IN_UNIT[kind]) if kind in STEP_IN_UNIT else 1.0
    return units.number(step, unit)


def crosses_edge(plane: Plane, setups: Sequence[str]) -> bool:
    """Whether the path leaves the figure on one side and returns on the other."""
    for k, (setup, following) in enumerate(itertools.pairwise(setups)):
        start, end = plane.at[k], plane.at[k + 1]
        if setup == following and _turn_back(plane, start, end).any():
            return True
    return False


def _turn_back(plane: Plane, start: Array, end: Array) -> Array:
    """Full turns (2,) to take from the end, so that the way from the start is short."""
    far = np.isfinite(plane.turn) & (np.abs(end - start) > plane.turn / 2.0)
    return np.where(far, np.copysign(FULL_TURN, end - start), 0.0)


def _panel(
    axes: Axes,
    plane: Plane,
    group: Index,
    colour: str,
) -> None:
    look: Any = {"color": colour, "lw": 0.7, "zorder": 1}
    look["alpha"] = 0.55 if len(group) < MANY else 0.2
    for start, end in itertools.pairwise(plane.at[group]):
        back = _turn_back(plane, start, end)
        axes.plot(*np.array([start, end - back]).T, **look)
        if back.any():  # out on one side, in on the other
            axes.plot(*np.array([start + back, end]).T, **look)
    for k, which in enumerate("xy"):
        getattr(axes, f"set_{which}lim")(*plane.limits[:, k])
        ticks = _ticks(plane.names[k], plane.turn[k])
        getattr(axes, f"{which}axis").set_major_locator(ticks)


def _ticks(name: str, turn: float) -> MultipleLocator | MaxNLocator:
    """Quarters of a turn, or a few round numbers."""
    if math.isfinite(turn):
        return MultipleLocator(turn / 4.0)
    return MaxNLocator(
        6,
        steps=[1, 2, 5, 10],
        integer=name == "reading",
    )


def _numbers_by_place(
    plane: Plane, group: Index
) -> Mapping[tuple[float, float], list[int]]:
    """Numbers of the readings at each place, first and last reading's places first."""
    finite = [int(k) for k in group if np.isfinite(plane.at[k]).all()]
    places = {k: tuple(plane.at[k].round(3).tolist()) for k in finite}
    numbers: dict[tuple[float, float], list[int]] = {
        places[k]: [] for k in [*finite[:1], *finite[-1:], *finite]
    }
    for k in finite:
        numbers[places[k]].append(k + 1)
    return numbers


# -- numbers ---------------------------------------------------------------------------


def write(
    axes: Axes, numbers: Mapping[tuple[float, float], Sequence[int]], colour: str
) -> None:
    """Mark each place and write its numbers; where there is no room, only the mark."""
    points = POINTS_PER_INCH / axes.figure.dpi
    corners = axes.bbox.get_points() * points
    taken: list[tuple[Array, Array]] = []
    for point, readings in numbers.items():
        axes.plot(
            *point,
            "o",
            color=colour,
            ms=2.4,
            zorder=2,
        )
        phrase = _joined(readings)
        half = LETTER_SIZE * np.array([FRAME + LETTER * len(phrase), HALF_HEIGHT])
        pixel = np.asarray(axes.transData.transform(point)) * points
        centre = _free_centre(pixel, half, corners, taken)
        if centre is not None:
            taken.append((centre, half))
            _annotate(axes, phrase, point, centre - pixel, colour)


def _joined(readings: Sequence[int]) -> str:
    """1 2 3, or 1 … 9 where they are many."""
    numbers = [str(n) for n in readings]
    if len(numbers) > MOST_NUMBERS:
        numbers = [numbers[0], "…", numbers[-1]]
    return " ".join(numbers)


def _free_centre(
    point: Array, half: Array, corners: Array, taken: Sequence[tuple[Array, Array]]
) -> Array | None:
    """The first centre about a place where a label covers no other, in points."""
    middle, room = corners.mean(axis=0), np.ptp(corners, axis=0) / 2.0
    for offset in OFFSETS:
        centre = point + DISTANCE * half * offset
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
    axes: Axes, phrase: str, point: tuple[float, float], shift: Array, colour: str
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
    note = axes.annotate(phrase, point, offset, textcoords="offset points", **look)
    note.set_in_layout(False)
