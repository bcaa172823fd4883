"""The machine at its home pose with the planned tool points, in 3-D, axes in mm."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from oed import units
from oed.arrays import Array
from oed.result import Drawing
from pkm_reports import style
from pkm_reports.figures import scene
from pkm_reports.figures.scene import Box

LINES: Final = {
    "machine": {"color": style.INK, "lw": 1.8},
    "path": {"color": style.GREY, "lw": 0.7, "ls": ":"},
    "reading": {"color": style.GREY, "lw": 0.6},
    "cup": {"color": style.GREY, "lw": 1.0},
}
#: set-ups named in the legend
MOST_NAMES: Final = 8
#: steps of a line that is cut at the box
STEPS: Final = 60
PANEL_HEIGHT, LEGEND_LINE = 3.55, 0.18  # inches
LEGEND_CHARACTERS, MARKER_CHARACTERS = 100, 7


@dataclasses.dataclass(frozen=True, slots=True)
class Scene:
    """What is drawn, mm.

    lines     kind and points (n, 3) of each polyline
    tips      tool points (n, 3)
    bars      the reading's far end and the tool point, (2, 3) each
    setups    set-up of each tool point
    """

    lines: Sequence[tuple[str, Array]]
    tips: Array
    bars: Sequence[Array]
    setups: Sequence[str]

    def whole_box(self) -> Box:
        """A box around everything."""
        return self._box_around([line for _, line in self.lines])

    def readings_box(self) -> Box:
        """A box around the readings and their cups."""
        return self._box_around([line for kind, line in self.lines if kind == "cup"])

    def _box_around(self, lines: Sequence[Array]) -> Box:
        clouds = [points for points in (*lines, self.tips, *self.bars) if len(points)]
        return scene.box_around(np.vstack(clouds))


def draw(drawing: Drawing) -> Figure:
    """The whole machine on the left, the readings from closer by on the right."""
    tips = points_mm(drawing.tool_points)
    if not drawing.lines and not len(tips):
        return style.empty("No drawing is stored in this result.")
    shown = Scene(
        lines=[(line.kind, points_mm(line.points)) for line in drawing.lines],
        tips=tips,
        bars=[points_mm(bar) for bar in drawing.bars],
        setups=_setup_of_each(drawing, len(tips)),
    )
    entries = _legend_entries(shown)
    longest = max(len(str(entry.get_label())) for entry in entries)
    fitting = LEGEND_CHARACTERS // (MARKER_CHARACTERS + longest)
    columns = max(2, min(len(entries), fitting))
    legend_height = 0.1 + LEGEND_LINE * math.ceil(len(entries) / columns)
    figure = style.figure(PANEL_HEIGHT + legend_height)
    figure.set_layout_engine("none")
    foot = legend_height / (PANEL_HEIGHT + legend_height)
    whole, close = shown.whole_box(), shown.readings_box() if len(tips) else None
    _panel(figure, (0.0, foot), "The machine at home and all readings", shown, whole)
    _panel(figure, (0.5, foot), "The readings, enlarged", shown, close or whole)
    figure.legend(handles=entries, loc="lower center", ncols=columns, borderaxespad=0.2)
    return figure


def points_mm(points: Sequence[Sequence[float]]) -> Array:
    """Points (n, 3) given in m, in mm."""
    return units.from_si(np.array(points, dtype=float).reshape(-1, 3), "mm")


def _setup_of_each(drawing: Drawing, count: int) -> list[str]:
    """Set-up of each tool point; those that name none are just readings."""
    return [*drawing.reading_of, *["reading"] * count][:count]


def _panel(
    figure: Figure, corner: tuple[float, float], title: str, shown: Scene, box: Box
) -> None:
    edge, foot = corner
    place = (edge, 0.1, 0.5, 0.84)
    axes: Any = figure.add_axes(place, projection="3d", proj_type="ortho")
    figure.text(edge + 0.03, 0.955, title, fontsize=8.5, fontweight="bold")
    colours = style.colours(shown.setups)
    for setup, bar in zip(shown.setups, shown.bars, strict=False):
        ends = _inside(bar, box)
        axes.plot(
            *ends.T,
            color=colours[setup],
            lw=0.6,
            alpha=0.45,
        )
    for kind, line in shown.lines:
        _line(axes, kind, line, box)
    for k, (setup, colour) in enumerate(colours.items()):
        tips = shown.tips[[name == setup for name in shown.setups]]
        look: Any = {
            "s": 16,
            "depthshade": False,
            "lw": 0.3,
            "ec": "white",
        }
        axes.scatter(
            *tips.T,
            color=colour,
            marker=style.marker(k),
            **look,
        )
    scene.set_axes(axes, box)
    scene.fit_to(figure, axes, box, (edge + 0.015, foot, edge + 0.485, 0.93))


def _line(
    axes: Any,
    kind: str,
    line: Array,
    box: Box,
) -> None:
    """A polyline; a cup given as one point is drawn as a cross."""
    inside = _inside(line, box).T
    if len(line) == 1:
        cross: Any = {"color": style.INK, "marker": "x", "s": 30}
        axes.scatter(*inside, depthshade=False, **cross)
        return
    look: Any = LINES.get(kind, LINES["reading"])
    axes.plot(*inside, solid_capstyle="round", **look)


def _inside(line: Array, box: Box) -> Array:
    """The line with gaps outside the box, in fine steps: 3-D axes clip nothing."""
    low, high = box
    if len(line) < 2 or (np.all(line >= low) and np.all(line <= high)):
        return line
    corners = np.arange(len(line))
    at = np.linspace(0.0, len(line) - 1.0, 1 + STEPS * (len(line) - 1))
    fine = np.column_stack([np.interp(at, corners, x) for x in line.T])
    inside = (fine >= low) & (fine <= high)
    fine[~inside.all(axis=1)] = np.nan
    return fine


def _legend_entries(shown: Scene) -> list[Line2D]:
    """Set-ups by marker and colour, then machine, bars and cups."""
    colours = list(style.colours(shown.setups).items())
    entries = []
    for k, (setup, colour) in enumerate(colours[:MOST_NAMES]):
        look: Any = {
            "ls": "",
            "marker": style.marker(k),
            "color": colour,
        }
        entries.append(
            Line2D(
                [],
                [],
                label=style.label(setup, 24),
                **look,
            )
        )
    more = len(colours) - MOST_NAMES
    if more > 0:
        entries.append(
            Line2D(
                [],
                [],
                ls="",
                label=f"and {more} more",
            )
        )
    entries.append(
        Line2D(
            [],
            [],
            color=style.INK,
            lw=1.8,
            label="machine",
        )
    )
    if shown.bars:
        label = "bar or line of sight"
        entries.append(
            Line2D(
                [],
                [],
                color=style.GREY,
                lw=0.7,
                label=label,
            )
        )
    if any(kind == "cup" for kind, _ in shown.lines):
        cross: Any = {"ls": "", "marker": "x", "color": style.INK}
        entries.append(Line2D([], [], label="cup or fixed end", **cross))
    return entries
