"""The machine at its home pose with the tool points of the plan, in 3-D, axes in mm."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped]

from oed.arrays import Array
from pkm_reports import style

Points = Array
Box = tuple[Points, Points]
LINES: Final = {
    "machine": {"color": style.INK, "lw": 1.8},
    "path": {"color": style.GREY, "lw": 0.7, "ls": ":"},
    "reading": {"color": style.GREY, "lw": 0.6},
    "cup": {"color": style.GREY, "lw": 1.0},
}
VIEW: Final = {"elev": 20.0, "azim": -58.0}
MOST_NAMES: Final = 8
STEPS: Final = 60
PANEL: Final = 3.55  # inches
LEGEND_LINE: Final = 0.18  # inches


@dataclasses.dataclass(frozen=True, slots=True)
class Scene:
    """What is drawn, mm."""

    lines: Sequence[tuple[str, Points]]
    tips: Points
    bars: Sequence[Points]
    named: Sequence[str]

    @property
    def names(self) -> list[str]:
        """Set-up of each tool point."""
        return [*self.named, *["reading"] * len(self.tips)][: len(self.tips)]

    def box(self, whole: bool) -> Box:
        """Lower and upper corner around everything, or around the readings; a flat one
        gets some depth.
        """
        lines = [p for kind, p in self.lines if whole or kind == "cup"]
        cloud = np.vstack([p for p in (*lines, self.tips, *self.bars) if len(p)])
        low, high = np.nanmin(cloud, axis=0), np.nanmax(cloud, axis=0)
        size = np.maximum(high - low, 0.3 * max(float(np.max(high - low)), 1.0)) * 1.06
        return (low + high - size) / 2.0, (low + high + size) / 2.0


def draw(drawing: Mapping[str, Any]) -> Figure:
    """Left the whole machine, right the readings seen closer."""
    lines = [
        (line.get("kind", "machine"), points(line["points"]))
        for line in drawing.get("lines") or []
    ]
    tips = points(drawing.get("tool_points") or [])
    if not lines and not len(tips):
        return style.empty("No drawing is stored in this result.")
    scene = Scene(
        lines,
        tips,
        [points(bar) for bar in drawing.get("bars") or []],
        drawing.get("reading_of") or [],
    )
    marks = _marks(scene)
    columns = max(
        2,
        min(len(marks), 100 // (7 + max(len(str(mark.get_label())) for mark in marks))),
    )
    below = 0.1 + LEGEND_LINE * math.ceil(len(marks) / columns)
    figure = style.figure(PANEL + below)
    figure.set_layout_engine("none")
    foot = below / (PANEL + below)
    _panel(
        figure,
        (0.0, foot),
        "The machine at home and all readings",
        scene,
        scene.box(whole=True),
    )
    _panel(
        figure,
        (0.5, foot),
        "The readings seen closer",
        scene,
        scene.box(whole=not len(tips)),
    )
    figure.legend(handles=marks, loc="lower center", ncols=columns, borderaxespad=0.2)
    return figure


def points(values: Sequence[Sequence[float]]) -> Points:
    """Points (n, 3) in mm."""
    return 1e3 * style.array(values).reshape(-1, 3)


def _panel(
    figure: Figure, corner: tuple[float, float], title: str, scene: Scene, box: Box
) -> None:
    left, foot = corner
    axes: Any = figure.add_axes(
        (left, 0.1, 0.5, 0.84), projection="3d", proj_type="ortho"
    )
    figure.text(left + 0.03, 0.955, title, fontsize=8.5, fontweight="bold")
    colour = style.colours(scene.names)
    for name, bar in zip(scene.names, scene.bars, strict=False):
        axes.plot(*_inside(bar, box).T, color=colour[name], lw=0.6, alpha=0.45)
    for kind, line in scene.lines:
        _line(axes, kind, line, box)
    for k, (name, shade) in enumerate(colour.items()):
        chosen = scene.tips[[n == name for n in scene.names]]
        axes.scatter(
            *chosen.T,
            color=shade,
            s=16,
            marker=style.marker(k),
            depthshade=False,
            lw=0.3,
            ec="white",
        )
    _frame(axes, box)
    _fit(figure, axes, box, (left + 0.015, foot, left + 0.485, 0.93))


def _line(axes: Any, kind: str, line: Points, box: Box) -> None:
    """A polyline; a cup given as one point is drawn as a mark."""
    if len(line) == 1:
        axes.scatter(
            *_inside(line, box).T, color=style.INK, marker="x", s=30, depthshade=False
        )
    else:
        axes.plot(
            *_inside(line, box).T,
            solid_capstyle="round",
            **LINES.get(kind, LINES["reading"]),
        )


def _inside(line: Points, box: Box) -> Points:
    """The line in fine steps, with gaps outside the box: axes in 3-D clip nothing
    themselves.
    """
    share = np.linspace(0.0, len(line) - 1.0, 1 + STEPS * (len(line) - 1))
    fine = np.column_stack(
        [np.interp(share, np.arange(len(line)), coordinate) for coordinate in line.T]
    )
    if len(line) > 1 and not (np.all(line >= box[0]) and np.all(line <= box[1])):
        fine[~np.all((fine >= box[0]) & (fine <= box[1]), axis=1)] = np.nan
        return fine
    return line


def _frame(axes: Any, box: Box) -> None:
    """Limits, equal scale on all axes, few ticks."""
    size = box[1] - box[0]
    for k, name in enumerate("xyz"):
        getattr(axes, f"set_{name}lim")(box[0][k], box[1][k])
        getattr(axes, f"set_{name}label")(
            f"{name} [mm]", labelpad=-2.0 if size[k] < 0.6 * size.max() else 0.0
        )
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(
            MaxNLocator(
                3 if size[k] < 0.6 * size.max() else 5, steps=[1, 2, 2.5, 5, 10]
            )
        )
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_tick_params(pad=-1.0, labelsize=6.5)
    axes.zaxis.set_tick_params(pad=1.0)
    axes.set_box_aspect(size)
    axes.view_init(**VIEW)


def _fit(
    figure: Figure, axes: Any, box: Box, room: tuple[float, float, float, float]
) -> None:
    """Moves and scales the axes until box, ticks and labels fill the room (figure
    shares: left, bottom, right, top).

    How much of its rectangle a 3-D box takes depends on its shape and the view; letters
    do not scale, so more than once.
    """
    middle, wanted = (
        np.array([room[0] + room[2], room[1] + room[3]]) / 2.0,
        np.array(room[2:]) - room[:2],
    )
    canvas: Any = FigureCanvasAgg(figure)
    for _ in range(3):
        figure.draw_without_rendering()
        taken = [
            axis.get_tightbbox(canvas.get_renderer())
            for axis in (axes.xaxis, axes.yaxis, axes.zaxis)
        ]
        taken.append(_outline(axes, box))
        (x0, y0), (x1, y1) = figure.transFigure.inverted().transform(
            Bbox.union(taken).get_points()
        )
        place = axes.get_position()
        scale = min(wanted / [x1 - x0, y1 - y0])
        corner = middle + scale * (
            np.array([place.x0, place.y0]) - [(x0 + x1) / 2.0, (y0 + y1) / 2.0]
        )
        axes.set_position((*corner, scale * place.width, scale * place.height))


def _outline(axes: Any, box: Box) -> Bbox:
    """Rectangle on the canvas around the eight corners of the 3-D box."""
    corners = np.array(list(itertools.product(*zip(*box, strict=True))))
    x, y, _ = proj3d.proj_transform(*corners.T, axes.get_proj())
    spots = axes.transData.transform(np.column_stack([x, y]))
    return Bbox([spots.min(axis=0), spots.max(axis=0)])


def _marks(scene: Scene) -> list[Line2D]:
    """Entries of the legend."""
    shades = list(style.colours(scene.names).items())
    marks = [
        Line2D(
            [],
            [],
            ls="",
            marker=style.marker(k),
            color=shade,
            label=style.safe(name, 24),
        )
        for k, (name, shade) in enumerate(shades[:MOST_NAMES])
    ]
    more = len(shades) - MOST_NAMES
    marks += [Line2D([], [], ls="", label=f"and {more} more")] if more > 0 else []
    marks.append(Line2D([], [], color=style.INK, lw=1.8, label="machine"))
    marks += (
        [Line2D([], [], color=style.GREY, lw=0.7, label="bar or line of sight")]
        if scene.bars
        else []
    )
    cups = any(kind == "cup" for kind, _ in scene.lines)
    return marks + (
        [Line2D([], [], ls="", marker="x", color=style.INK, label="cup or fixed end")]
        if cups
        else []
    )
