"""A machine at its guess, and where its closure is met best: what keeps it open.

For a machine that does not assemble. On the left the machine in 3-D, on the right by how
much each equation is missed.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from oed import units
from oed.base import Array
from oed.result import ClosestClosure, MachineShape
from pkm_reports import style, text
from pkm_reports.sections.figures import scene

#: inches
WIDTH: Final = 9.0
LEAST_HEIGHT, ROW, HEAD = 4.4, 0.34, 1.4
#: share of the drawing's size that an axis of a frame is long
FRAME: Final = 0.12
#: an amount, m or rad, up to which bars show nothing
NOTHING: Final = 1e-6
#: the drawing and the bars, as shares of the figure: left, bottom, right, top
DRAWING: Final = (0.02, 0.09, 0.62, 0.92)
BARS: Final = (0.72, 0.16, 0.24, 0.70)
BASE: Final = "base frame"
GUESS_LOOK: Final = {"color": style.GREY, "lw": 0.9, "ls": (0, (4, 2))}
NEAREST_LOOK: Final = {"color": style.INK, "lw": 1.8}
OPEN_LOOK: Final = {"color": style.RED, "lw": 2.6}


def draw_closure(closure: ClosestClosure, title: str, joints: list[str]) -> Figure:
    """The figure; `joints` are the names of the machine's joints, as its struts."""
    count = len(closure.guess.equations)
    height = max(LEAST_HEIGHT, HEAD + ROW * count)
    figure = style.placed_figure(height, WIDTH)
    look: Any = {"fontsize": 10, "fontweight": "bold", "va": "top"}
    figure.text(0.02, 0.98, style.label(title, 120), **look)
    _drawing(figure, closure, joints)
    _bars(figure.add_axes(BARS), closure)
    legend: Any = {"loc": "lower left", "ncols": 4, "bbox_to_anchor": (0.02, 0.0)}
    figure.legend(handles=_legend(closure), **legend)
    return figure


# -- the machine -----------------------------------------------------------------------


def _drawing(figure: Figure, closure: ClosestClosure, joints: list[str]) -> None:
    cloud = np.vstack([_points(closure.guess), _points(closure.nearest)])
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if not len(cloud):
        look: Any = {"ha": "center", "color": style.GREY}
        figure.text(0.3, 0.5, "The machine has no place at its guess.", **look)
        return
    box = scene.box_around(cloud)
    ends = units.from_si(closure.nearest.struts[:, 0], "mm")
    azimuth = scene.clearest_azimuth(ends) if len(ends) else scene.AZIMUTHS[0]
    x, y, right, top = DRAWING
    bounds = (x, y, right - x, top - y)
    axes: Any = figure.add_axes(bounds, projection="3d", proj_type="ortho")
    for shape, look in (
        (closure.guess, GUESS_LOOK),
        (closure.nearest, NEAREST_LOOK),
    ):
        for line in shape.lines or tuple(shape.struts):
            axes.plot(*units.from_si(line, "mm").T, **look)
    _open_lines(axes, closure)
    _struts(axes, closure, joints)
    size = float((box[1] - box[0]).max())
    _frame(axes, np.zeros(3), np.eye(3), FRAME * size, BASE)
    tool, turned = units.from_si(closure.nearest.tool, "mm"), closure.nearest.axes
    _frame(axes, tool, turned, FRAME * size, "tool point")
    scene.set_axes(axes, box, azimuth)
    scene.fit_to(figure, axes, box, DRAWING)


def _points(shape: MachineShape) -> Array:
    """All points (n, 3) of a machine with both frames, mm."""
    parts = [*shape.lines, shape.struts.reshape(-1, 3), shape.tool[None]]
    return units.from_si(np.vstack([*parts, np.zeros((1, 3))]), "mm")


def _open_joints(closure: ClosestClosure) -> set[str]:
    return {name for k in closure.still_open for name in closure.joints[k]}


def _open_lines(axes: Any, closure: ClosestClosure) -> None:
    """Lines that the joints of open equations move, of a machine without struts."""
    if len(closure.nearest.struts):
        return
    joints = _open_joints(closure)
    pairs = zip(closure.nearest.lines, closure.line_joints, strict=True)
    for line, moving in pairs:
        if joints & set(moving):
            axes.plot(*units.from_si(line, "mm").T, **OPEN_LOOK)


def _struts(axes: Any, closure: ClosestClosure, joints: list[str]) -> None:
    """Ends of the struts, the joints' names, and the struts of open equations."""
    struts = units.from_si(closure.nearest.struts, "mm")
    open_joints = _open_joints(closure)
    white: Any = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.4}
    for name, ends in zip(joints, struts, strict=False):
        is_open = name in open_joints
        colour = style.RED if is_open else style.BLUE
        axes.scatter(*ends.T, color=colour, s=14, depthshade=False)
        if is_open:
            axes.plot(*ends.T, **OPEN_LOOK)
        letters: Any = {"fontsize": 8, "color": colour, "ha": "center", "bbox": white}
        axes.text(*(0.75 * ends[0] + 0.25 * ends[1]), style.label(name), **letters)


def _frame(axes: Any, origin: Array, turned: Array, length: float, name: str) -> None:
    """Three axes from an origin, with its name."""
    if not np.isfinite(origin).all():
        return
    for letter, direction in zip("xyz", turned.T, strict=True):
        end = origin + length * direction
        axes.plot(*np.array([origin, end]).T, color=style.GREEN, lw=1.2)
        if name == BASE:
            axes.text(*end, letter, fontsize=7, color=style.GREEN)
    axes.scatter(*origin, color=style.GREEN, s=16, depthshade=False)
    look: Any = {"fontsize": 7.5, "color": style.GREEN, "ha": "right"}
    look["va"] = "top" if name == BASE else "bottom"
    axes.text(*origin, f"{name}  ", **look)


# -- the equations ---------------------------------------------------------------------


def _bars(axes: Axes, closure: ClosestClosure) -> None:
    """By how much each equation is missed, at the guess and at best."""
    guess, nearest = np.abs(closure.guess.equations), np.abs(closure.nearest.equations)
    rows = range(len(guess))
    finite = np.nan_to_num
    above, below = [k - 0.19 for k in rows], [k + 0.19 for k in rows]
    axes.barh(above, finite(guess), height=0.34, color=style.LIGHT)
    colours = [style.RED if k in closure.still_open else style.INK for k in rows]
    axes.barh(below, finite(nearest), height=0.34, color=colours)
    widest = max(float(finite(guess).max()), float(finite(nearest).max()), NOTHING)
    axes.set_xlim(0.0, 1.45 * widest)
    if widest <= NOTHING:
        axes.set_xticks([])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    for k in rows:
        _amount(axes, guess[k], k - 0.19, style.GREY)
        closes = k not in closure.still_open
        phrase = "closes" if closes else _words(nearest[k])
        _amount(axes, 0.0 if closes else nearest[k], k + 0.19, colours[k], phrase)
    names = [_name(k, closure.joints[k]) for k in rows]
    style.fixed_ticks(axes, "y", list(map(float, rows)), names)
    axes.set_xlabel("missed by [m or rad]")
    axes.set_title("Equations of the closure")
    axes.grid(visible=False, axis="y")


def _amount(
    axes: Axes, value: float, row: float, colour: str, phrase: str | None = None
) -> None:
    """A number at the end of its bar."""
    look: Any = {"va": "center", "fontsize": 7, "color": colour}
    end = float(np.nan_to_num(value))
    axes.text(end, row, f" {_words(value) if phrase is None else phrase}", **look)


def _words(value: float) -> str:
    if value <= NOTHING:
        return "0"
    return text.trimmed(value, 3) if np.isfinite(value) else "no value"


def _name(k: int, joints: tuple[str, ...]) -> str:
    """`2 (q2)`; of many joints the first ones."""
    if not joints:
        return f"{k + 1}"
    more = ", …" if len(joints) > 2 else ""
    return f"{k + 1} ({', '.join(joints[:2])}{more})"


def _legend(closure: ClosestClosure) -> list[Line2D]:
    entries: list[Any] = [
        Line2D([], [], label="at the guess", **GUESS_LOOK),  # type: ignore[arg-type]
        Line2D([], [], label="where the closure is met best", **NEAREST_LOOK),  # type: ignore[arg-type]
    ]
    if closure.still_open:
        entries.append(Line2D([], [], label="open", **OPEN_LOOK))  # type: ignore[arg-type]
    return entries
