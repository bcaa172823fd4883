"""The machine at home with all readings, small, for the first page."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from oed.base import Array
from oed.result import Drawing, DrawingLabel
from pkm_reports import style
from pkm_reports.sections.figures import scene
from pkm_reports.sections.figures.scene import Box, Rectangle
from pkm_reports.view import points_mm

# The machine at its home pose with the planned tool points, in 3-D, axes in mm.

LINES: Final = {
    "machine": {"color": style.INK, "lw": 1.8},
    "path": {"color": style.GREY, "lw": 0.7, "ls": ":"},
    "reading": {"color": style.GREY, "lw": 0.6},
    "cup": {"color": style.GREY, "lw": 1.0},
}
#: set-ups named in the legend
MOST_NAMES: Final = 8
#: readings of a set-up that are drawn, about: more hide each other
MOST_DRAWN: Final = 400
#: steps of a line that is cut at the box
STEPS: Final = 60
PANEL_HEIGHT, LEGEND_LINE = 3.55, 0.18  # inches
LEGEND_CHARACTERS, MARKER_CHARACTERS = 100, 7


@dataclasses.dataclass(frozen=True, slots=True)
class Scene:
    """What is drawn, mm.

    lines     kind and points (n, 3) of each polyline
    tips      tool points (n, 3)
    bars      the reading's far end and the tool point, (2, 3) each; (0, 3) without
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


def draw_machine(drawing: Drawing) -> Figure:
    """The machine with its parameters on the left, the readings from closer by."""
    shown = scene_of(drawing)
    if not shown.lines and not len(shown.tips):
        return style.empty("No drawing is stored in this result.")
    entries = legend_entries(shown)
    longest = max(len(str(entry.get_label())) for entry in entries)
    fitting = LEGEND_CHARACTERS // (MARKER_CHARACTERS + longest)
    columns = max(2, min(len(entries), fitting))
    legend_height = 0.1 + LEGEND_LINE * math.ceil(len(entries) / columns)
    figure = style.placed_figure(PANEL_HEIGHT + legend_height)
    foot = legend_height / (PANEL_HEIGHT + legend_height)
    whole, close = shown.whole_box(), shown.readings_box() if len(shown.tips) else None
    titles = ("The machine at home and all readings", "The readings, enlarged")
    if drawing.labels:
        titles = ("The machine at home: where its parameters act", titles[1])
    for edge, title in zip((0.0, 0.5), titles, strict=True):
        figure.text(edge + 0.03, 0.955, title, fontsize=8.5, fontweight="bold")
    room = (0.015, foot, 0.485, 0.93)
    if drawing.labels:
        _labelled(figure, room, shown, drawing.labels)
    else:
        panel(figure, room, shown, whole)
    panel(figure, (0.515, foot, 0.985, 0.93), shown, close or whole)
    figure.legend(handles=entries, loc="lower center", ncols=columns, borderaxespad=0.2)
    return figure


def scene_of(drawing: Drawing) -> Scene:
    """What a drawing shows, mm; of many readings of a set-up every so-manieth."""
    tips = points_mm(drawing.tool_points)
    setups = _setup_of_each(drawing, len(tips))
    shown = _evenly(setups)
    # results of older versions list far ends only where there is one: of which reading
    # is then unknown
    bars = drawing.bars if len(drawing.bars) == len(tips) else []
    return Scene(
        lines=[(line.kind, points_mm(line.points)) for line in drawing.lines],
        tips=tips[shown],
        bars=[points_mm(bars[k]) for k in shown] if bars else [],
        setups=[setups[k] for k in shown],
    )


def _evenly(setups: Sequence[str]) -> list[int]:
    """Numbers of the readings that are drawn: MOST_DRAWN of a set-up, about."""
    names = np.array(setups)
    shown: list[int] = []
    for name in dict.fromkeys(setups):
        members = np.flatnonzero(names == name)
        shown += members[:: -(-len(members) // MOST_DRAWN)].tolist()
    return sorted(shown)


def _labelled(
    figure: Figure, room: Rectangle, shown: Scene, labels: Sequence[DrawingLabel]
) -> None:
    """The machine alone, with the names of its parameters at the points they move."""
    places = points_mm([label.at for label in labels])
    lines = [line for line in shown.lines if line[0] == "machine"]
    alone = dataclasses.replace(shown, lines=lines, tips=places[:0], bars=[], setups=[])
    cloud = np.vstack([places, *[points for _, points in lines]])
    azimuth = scene.clearest_azimuth(places)
    axes = panel(figure, room, alone, scene.box_around(cloud), azimuth)
    white: Any = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.4}
    look: Any = {"fontsize": 6.5, "color": style.BLUE, "bbox": white, "ha": "center"}
    for position, label in zip(places, labels, strict=True):
        axes.text(*position, style.label(label.text, 24), **look)


def _setup_of_each(drawing: Drawing, count: int) -> list[str]:
    """Set-up of each tool point; those that name none are just readings."""
    return [*drawing.reading_of, *["reading"] * count][:count]


def panel(
    figure: Figure,
    room: Rectangle,
    shown: Scene,
    box: Box,
    azimuth: float = scene.VIEW["azim"],
) -> Any:
    """Draw a scene inside a box; the axes fill a rectangle of the figure."""
    bounds = (room[0], room[1], room[2] - room[0], room[3] - room[1])
    axes: Any = figure.add_axes(bounds, projection="3d", proj_type="ortho")
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
    scene.set_axes(axes, box, azimuth)
    scene.fit_to(figure, axes, box, room)
    return axes


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
    grid = np.linspace(0.0, len(line) - 1.0, 1 + STEPS * (len(line) - 1))
    fine = np.column_stack([np.interp(grid, corners, x) for x in line.T])
    inside = (fine >= low) & (fine <= high)
    fine[~inside.all(axis=1)] = np.nan
    return fine


def legend_entries(shown: Scene) -> list[Line2D]:
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
    if any(map(len, shown.bars)):
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


#: inches: readable at the width of a telephone
WIDTH, HEIGHT = 3.4, 3.0
#: legend entries side by side
COLUMNS: Final = 2


def draw_overview(drawing: Drawing) -> Figure:
    """One view of machine, bars and tool points, with a short legend."""
    shown = scene_of(drawing)
    figure = style.placed_figure(HEIGHT, WIDTH)
    entries = legend_entries(shown)
    lines = -(-len(entries) // COLUMNS)
    foot = (0.08 + LEGEND_LINE * lines) / HEIGHT
    panel(figure, (0.0, foot, 1.0, 1.0), shown, shown.whole_box())
    legend: Any = {"ncols": COLUMNS, "borderaxespad": 0.1, "columnspacing": 1.0}
    figure.legend(handles=entries, loc="lower center", **legend)
    return figure
