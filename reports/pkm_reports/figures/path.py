"""The way through the poses in working order, in command space, one panel for each
set-up.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from oed import units
from oed.arrays import Array, Index
from pkm_reports import style, words

Part = Mapping[str, Any]
#: a full turn, degrees
FULL: Final = 360.0
MOST_PANELS: Final = 12
#: where a number may stand about its spot, in its own widths and heights
ASIDE: Final = np.array(
    [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1], [-1, -1]],
    dtype=float,
)
#: numbers of readings told at one spot
MOST_NUMBERS: Final = 3
LETTERS: Final = 5.5  # points


@dataclasses.dataclass(frozen=True, slots=True)
class Plane:
    """The two coordinates shown, each reading's place (n, 2), full turns (2,) of those
    that go round, limits (2, 2).
    """

    names: tuple[str, str]
    at: Array
    turn: Array
    limits: Array


def draw(poses: Sequence[Part]) -> Figure:
    """Numbers are those of the readings, in working order."""
    plane = chosen(poses)
    if plane is None:
        return style.empty("No commanded poses are stored in this result.")
    setups = list(dict.fromkeys(str(pose["setup"]) for pose in poses))[:MOST_PANELS]
    columns = 1 if len(setups) == 1 else 2
    rows = math.ceil(len(setups) / columns)
    height = 3.2 if columns == 1 else 2.35
    figure = style.figure(0.2 + height * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    groups = [
        np.flatnonzero([str(pose["setup"]) == name for pose in poses])
        for name in setups
    ]
    for k, (axes, name, mine) in enumerate(
        zip(grid.ravel(), setups, groups, strict=False)
    ):
        _panel(axes, plane, mine, style.CYCLE[k % len(style.CYCLE)])
        axes.tick_params(labelbottom=k + columns >= len(setups))
        number = "" if len(setups) == 1 else f"{k + 1}: "
        axes.set_title(
            f"{number}{style.safe(name)}, {words.count(len(mine), 'reading')}"
        )
    for axes in grid.ravel()[len(setups) :]:
        axes.set_visible(False)
    figure.supxlabel(style.safe(words.heading(plane.names[0])), fontsize=8)
    figure.supylabel(style.safe(words.heading(plane.names[1])), fontsize=8)
    figure.draw_without_rendering()  # numbers need the panels' final size
    for k, (axes, mine) in enumerate(zip(grid.ravel(), groups, strict=False)):
        _number(axes, _spots(plane, mine), style.CYCLE[k % len(style.CYCLE)])
    return figure


def chosen(poses: Sequence[Part]) -> Plane | None:
    """The two coordinates that vary most, 1 mm counted as 1 degree; the number of the
    reading, where only one does.
    """
    names = list(
        dict.fromkeys(key for pose in poses for key in pose.get("command") or {})
    )
    table = {
        n: style.array([(pose.get("command") or {}).get(n) for pose in poses])
        for n in names
    }
    table = {n: values for n, values in table.items() if np.isfinite(values).any()}
    if not table:
        return None
    spread = {
        n: float(np.nanmax(values) - np.nanmin(values)) / _step(n)
        for n, values in table.items()
    }
    most = sorted(sorted(table, key=lambda n: -spread[n])[:2], key=names.index)
    if len(most) == 1 or min(spread[n] for n in most) == 0.0:
        one = max(most, key=lambda n: spread[n])
        table, most = (
            {"reading": np.arange(1.0, len(poses) + 1.0), one: table[one]},
            ["reading", one],
        )
    at = np.column_stack([table[n] for n in most])
    low, high = np.nanmin(at, axis=0), np.nanmax(at, axis=0)
    turn = np.array([FULL if words.parted(n)[1] == "deg" else np.inf for n in most])
    turn[~((high - low > FULL / 2.0) & (high - low <= FULL))] = np.inf
    # a coordinate that goes round is shown over one full turn
    room = np.where(
        np.isfinite(turn),
        (FULL - (high - low)) / 2.0,
        np.where(high > low, 0.07 * (high - low), 1.0),
    )
    return Plane((most[0], most[1]), at, turn, np.array([low - room, high + room]))


def around(plane: Plane, setups: Sequence[str]) -> bool:
    """Whether a way between two readings of one set-up leaves the figure on one side
    and comes back on the other.
    """
    pairs = [k for k in range(len(setups) - 1) if setups[k] == setups[k + 1]]
    return any(_back(plane, plane.at[k], plane.at[k + 1]).any() for k in pairs)


def _back(plane: Plane, a: Array, b: Array) -> Array:
    """Full turns (2,) to take from b, for the shorter way from a; only of coordinates
    that go round.
    """
    far = np.isfinite(plane.turn) & (np.abs(b - a) > plane.turn / 2.0)
    return np.where(far, np.copysign(FULL, b - a), 0.0)


def _step(name: str) -> float:
    """What counts as one step of a coordinate, in its own unit: 1 mm, 1 degree."""
    unit = words.parted(name)[1]
    step = {"m": 1e-3, "rad": math.radians(1.0)}.get(
        units.si_unit(unit) if unit else "", 1.0
    )
    return units.number(step, unit) if unit else step


def _panel(axes: Axes, plane: Plane, mine: Index, colour: str) -> None:
    faint = 0.55 if len(mine) < 100 else 0.2
    for a, b in zip(plane.at[mine[:-1]], plane.at[mine[1:]], strict=True):
        # the short way round: out on one side, in on the other
        back = _back(plane, a, b)
        for start, end in [(a, b - back), (a + back, b)][: 2 if back.any() else 1]:
            axes.plot(
                *np.array([start, end]).T, color=colour, lw=0.7, alpha=faint, zorder=1
            )
    for which, name, limits, turn in zip(
        "xy", plane.names, plane.limits.T, plane.turn, strict=True
    ):
        getattr(axes, f"set_{which}lim")(*limits)
        even = (
            MultipleLocator(turn / 4.0)
            if np.isfinite(turn)
            else MaxNLocator(6, steps=[1, 2, 5, 10], integer=name == "reading")
        )
        getattr(axes, f"{which}axis").set_major_locator(even)


def _spots(plane: Plane, mine: Index) -> dict[tuple[float, float], list[int]]:
    """Numbers of the readings at each place; the first and the last reading's places
    stand first.
    """
    known = [int(k) for k in mine if np.isfinite(plane.at[k]).all()]
    places = {
        k: (round(float(plane.at[k, 0]), 3), round(float(plane.at[k, 1]), 3))
        for k in known
    }
    spots: dict[tuple[float, float], list[int]] = {
        places[k]: [] for k in [*known[:1], *known[-1:], *known]
    }
    for k in known:
        spots[places[k]].append(k + 1)
    return spots


def _number(
    axes: Axes, spots: Mapping[tuple[float, float], list[int]], colour: str
) -> None:
    """Numbers at the spots, aside where others are in the way; where there is no room a
    spot stays without.
    """
    taken: list[Array] = []
    points = 72.0 / axes.figure.dpi
    corners = axes.bbox.get_points() * points
    middle, room = corners.mean(axis=0), np.ptp(corners, axis=0) / 2.0
    look: Any = {
        "fontsize": LETTERS,
        "annotation_clip": False,
        "zorder": 3,
        "ha": "center",
        "va": "center",
    }
    look["bbox"] = {
        "boxstyle": "round,pad=0.18",
        "fc": "white",
        "ec": colour,
        "lw": 0.7,
    }
    for spot, readings in spots.items():
        axes.plot(*spot, "o", color=colour, ms=2.4, zorder=2)
        numbers = [str(n) for n in readings]
        text = " ".join(
            numbers if len(numbers) <= MOST_NUMBERS else [numbers[0], "…", numbers[-1]]
        )
        at, half = (
            axes.transData.transform(spot) * points,
            LETTERS * np.array([0.45 + 0.33 * len(text), 0.8]),
        )
        for aside in ASIDE:
            centre = at + 2.2 * half * aside
            outside = aside.any() and (np.abs(centre - middle) > room).any()
            if not outside and not any(
                (np.abs(centre - c[:2]) < half + c[2:]).all() for c in taken
            ):
                taken.append(np.concatenate([centre, half]))
                axes.annotate(
                    text, spot, centre - at, textcoords="offset points", **look
                ).set_in_layout(False)
                break
