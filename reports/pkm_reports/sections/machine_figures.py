"""3-D axes with one scale on all axes, fitted to a rectangle of the figure."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from oed import units
from oed.base import Array
from oed.result import ClosestClosure, Drawing, DrawingLabel, MachineShape
from pkm_reports import style, text
from pkm_reports.view import points_mm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Bbox

# 3-D axes with one scale on all axes, fitted to a rectangle of the figure.

Box = tuple[Array, Array]  #: lower and upper corner (3,) of what is shown, mm
#: left, bottom, right and top of a rectangle, as shares of the figure
Rectangle = tuple[float, float, float, float]
VIEW: Final[dict[str, float]] = {"elev": 20.0, "azim": -58.0}
#: azimuths that a labelled drawing can be seen from, the usual one first
AZIMUTHS: Final[tuple[float, ...]] = (-58.0, *map(float, range(-85, -4, 5)))
#: width and height of a label, relative to one another
LETTERING: Final = np.array([3.0, 1.0])
MIN_DEPTH = 0.3  #: least depth of a box, as a share of its largest side
MARGIN = 1.06  #: size of the drawing over that of the box
#: share of the largest side below which an axis has few ticks
SHORT_AXIS_SHARE: Final = 0.6
#: letters do not scale with the box, so fitting takes more than one step
FITTING_STEPS: Final = 3


def box_around(cloud: Array) -> Box:
    """A box around points (n, 3); a flat one gets some depth."""
    low, high = np.nanmin(cloud, axis=0), np.nanmax(cloud, axis=0)
    longest = max(float(np.max(high - low)), 1.0)
    size = MARGIN * np.maximum(high - low, MIN_DEPTH * longest)
    return (low + high - size) / 2.0, (low + high + size) / 2.0


def clearest_azimuth(points: Array) -> float:
    """Azimuth, deg, of the largest least distance of points (n, 3); the usual if few."""
    if len(points) < 2:
        return AZIMUTHS[0]
    spread = [_least_distance(_drawn(points, azimuth)) for azimuth in AZIMUTHS]
    return AZIMUTHS[int(np.argmax(spread))]


def _drawn(points: Array, azimuth: float) -> Array:
    """Points (n, 2) to the right and up in the picture, from points (n, 3)."""
    turn, rise = np.radians(azimuth), np.radians(VIEW["elev"])
    x, y, z = points.T
    right = -x * np.sin(turn) + y * np.cos(turn)
    towards = x * np.cos(turn) + y * np.sin(turn)
    return np.column_stack([right, z * np.cos(rise) - towards * np.sin(rise)])


def _least_distance(points: Array) -> float:
    offsets = (points[:, None] - points[None]) / LETTERING
    distances = np.linalg.norm(offsets, axis=2)
    return float(distances[np.triu_indices(len(points), 1)].min())


def set_axes(axes: Any, box: Box, azimuth: float = VIEW["azim"]) -> None:
    """Limits of the box, one scale on all axes, few ticks."""
    size = box[1] - box[0]
    for k, name in enumerate("xyz"):
        short = size[k] < SHORT_AXIS_SHARE * size.max()
        getattr(axes, f"set_{name}lim")(box[0][k], box[1][k])
        set_label = getattr(axes, f"set_{name}label")
        set_label(f"{name} [mm]", labelpad=-2.0 if short else 0.0)
        axis = getattr(axes, f"{name}axis")
        style.few_ticks(axis, 2 if short else 4, steps=[1, 2, 2.5, 5, 10])
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_tick_params(pad=-1.0, labelsize=6.5)
    axes.zaxis.set_tick_params(pad=1.0)
    axes.set_box_aspect(size)
    axes.view_init(elev=VIEW["elev"], azim=azimuth)


def fit_to(figure: Figure, axes: Any, box: Box, room: Rectangle) -> None:
    """Move and scale 3-D axes until box, ticks and labels fill the rectangle."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    low, high = np.array(room[:2]), np.array(room[2:])
    middle, wanted = (low + high) / 2.0, high - low
    canvas: Any = FigureCanvasAgg(figure)
    axes.M = axes.get_proj()  # as drawing would set it, for the boxes of the labels
    for _ in range(FITTING_STEPS):
        axes.apply_aspect()
        (x0, y0), (x1, y1) = _extent(figure, axes, box, canvas.get_renderer())
        bounds = axes.get_position()
        scale = min(wanted / [x1 - x0, y1 - y0])
        centre = np.array([x0 + x1, y0 + y1]) / 2.0
        corner = middle + scale * (np.array([bounds.x0, bounds.y0]) - centre)
        axes.set_position((*corner, scale * bounds.width, scale * bounds.height))


def _extent(figure: Figure, axes: Any, box: Box, renderer: Any) -> Array:
    """Corners (2, 2) of what the axes cover, as shares of the figure."""
    from matplotlib.transforms import Bbox

    covered = [
        axis.get_tightbbox(renderer) for axis in (axes.xaxis, axes.yaxis, axes.zaxis)
    ]
    covered.append(_outline(axes, box))
    to_shares = figure.transFigure.inverted()
    return to_shares.transform(Bbox.union(covered).get_points())


def _outline(axes: Any, box: Box) -> Bbox:
    """Rectangle on the canvas around the eight corners of the 3-D box."""
    from matplotlib.transforms import Bbox
    from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped]

    corners = np.array(list(itertools.product(*zip(*box, strict=True))))
    x, y, _ = proj3d.proj_transform(*corners.T, axes.get_proj())
    pixels = axes.transData.transform(np.column_stack([x, y]))
    return Bbox([pixels.min(axis=0), pixels.max(axis=0)])


# The machine at its home pose with the planned tool points, in 3-D, axes in mm.

LINES: Final = {
    "machine": {"color": style.INK, "lw": 1.8},
    "path": {"color": style.GREY, "lw": 0.7, "ls": ":"},
    "reading": {"color": style.GREY, "lw": 0.6},
    "cup": {"color": style.GREY, "lw": 1.0},
}
MAX_NAMES: Final = 8  #: set-ups named in the legend
#: readings of a set-up that are drawn, about: more hide each other
MAX_DRAWN: Final = 400
LINE_STEPS: Final = 60  #: steps of a line that is cut at the box
PANEL_HEIGHT, LEGEND_LINE = 3.55, 0.18  # inches
LEGEND_CHARACTERS, MARKER_CHARACTERS = 100, 7


@dataclasses.dataclass(frozen=True, slots=True)
class Scene:
    """What is drawn, mm."""

    lines: Sequence[tuple[str, Array]]  #: kind and points (n, 3) of each polyline
    tips: Array  #: tool points (n, 3)
    #: the reading's far end and the tool point, (2, 3) each; (0, 3) without
    bars: Sequence[Array]
    setups: Sequence[str]  #: set-up of each tool point

    def whole_box(self) -> Box:
        """A box around everything."""
        return self._box_around([line for _, line in self.lines])

    def readings_box(self) -> Box:
        """A box around the readings and their cups."""
        return self._box_around([line for kind, line in self.lines if kind == "cup"])

    def _box_around(self, lines: Sequence[Array]) -> Box:
        clouds = [points for points in (*lines, self.tips, *self.bars) if len(points)]
        return box_around(np.vstack(clouds))


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
    whole = shown.whole_box()
    close = shown.readings_box() if len(shown.tips) else None
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
    count = len(tips)
    setups = [*drawing.reading_of, *["reading"] * count][:count]
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
    """Numbers of the readings that are drawn: MAX_DRAWN of a set-up, about."""
    names = np.array(setups)
    shown: list[int] = []
    for name in dict.fromkeys(setups):
        members = np.flatnonzero(names == name)
        shown += members[:: -(-len(members) // MAX_DRAWN)].tolist()
    return sorted(shown)


def _labelled(
    figure: Figure, room: Rectangle, shown: Scene, labels: Sequence[DrawingLabel]
) -> None:
    """The machine alone, with the names of its parameters at the points they move."""
    places = points_mm([label.at for label in labels])
    lines = [line for line in shown.lines if line[0] == "machine"]
    alone = dataclasses.replace(shown, lines=lines, tips=places[:0], bars=[], setups=[])
    cloud = np.vstack([places, *[points for _, points in lines]])
    azimuth = clearest_azimuth(places)
    axes = panel(figure, room, alone, box_around(cloud), azimuth)
    white: Any = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.4}
    look: Any = {"fontsize": 6.5, "color": style.BLUE, "bbox": white, "ha": "center"}
    for position, label in zip(places, labels, strict=True):
        axes.text(*position, style.label(label.text, 24), **look)


def panel(
    figure: Figure,
    room: Rectangle,
    shown: Scene,
    box: Box,
    azimuth: float = VIEW["azim"],
) -> Any:
    """Draw a scene inside a box; the axes fill a rectangle of the figure."""
    bounds = (room[0], room[1], room[2] - room[0], room[3] - room[1])
    axes: Any = figure.add_axes(bounds, projection="3d", proj_type="ortho")
    colours = style.colours(shown.setups)
    for setup, bar in zip(shown.setups, shown.bars, strict=False):
        ends = _inside(bar, box)
        axes.plot(*ends.T, color=colours[setup], lw=0.6, alpha=0.45)
    for kind, line in shown.lines:
        _line(axes, kind, line, box)
    for k, (setup, colour) in enumerate(colours.items()):
        tips = shown.tips[[name == setup for name in shown.setups]]
        look: Any = {"s": 16, "depthshade": False, "lw": 0.3, "ec": "white"}
        axes.scatter(*tips.T, color=colour, marker=style.marker(k), **look)
    set_axes(axes, box, azimuth)
    fit_to(figure, axes, box, room)
    return axes


def _line(axes: Any, kind: str, line: Array, box: Box) -> None:
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
    grid = np.linspace(0.0, len(line) - 1.0, 1 + LINE_STEPS * (len(line) - 1))
    fine = np.column_stack([np.interp(grid, corners, x) for x in line.T])
    inside = (fine >= low) & (fine <= high)
    fine[~inside.all(axis=1)] = np.nan
    return fine


def legend_entries(shown: Scene) -> list[Line2D]:
    """Set-ups by marker and colour, then machine, bars and cups."""
    from matplotlib.lines import Line2D

    colours = list(style.colours(shown.setups).items())
    entries = []
    for k, (setup, colour) in enumerate(colours[:MAX_NAMES]):
        look: Any = {"ls": "", "marker": style.marker(k), "color": colour}
        entries.append(Line2D([], [], label=style.label(setup, 24), **look))
    more = len(colours) - MAX_NAMES
    if more > 0:
        entries.append(Line2D([], [], ls="", label=f"and {more} more"))
    entries.append(Line2D([], [], color=style.INK, lw=1.8, label="machine"))
    if any(map(len, shown.bars)):
        label = "bar or line of sight"
        entries.append(Line2D([], [], color=style.GREY, lw=0.7, label=label))
    if any(kind == "cup" for kind, _ in shown.lines):
        cross: Any = {"ls": "", "marker": "x", "color": style.INK}
        entries.append(Line2D([], [], label="cup or fixed end", **cross))
    return entries


WIDTH, HEIGHT = 3.4, 3.0  #: inches: readable at the width of a telephone
# The machine at home with all readings, small, for the first page.

LEGEND_COLUMNS: Final = 2  #: legend entries side by side


def draw_overview(drawing: Drawing) -> Figure:
    """One view of machine, bars and tool points, with a short legend."""
    shown = scene_of(drawing)
    figure = style.placed_figure(HEIGHT, WIDTH)
    entries = legend_entries(shown)
    lines = -(-len(entries) // LEGEND_COLUMNS)
    foot = (0.08 + LEGEND_LINE * lines) / HEIGHT
    panel(figure, (0.0, foot, 1.0, 1.0), shown, shown.whole_box())
    legend: Any = {"ncols": LEGEND_COLUMNS, "borderaxespad": 0.1, "columnspacing": 1.0}
    figure.legend(handles=entries, loc="lower center", **legend)
    return figure


# A machine at its guess, and where its closure is met best: what keeps it open.

CLOSURE_WIDTH: Final = 9.0  #: inches
MIN_HEIGHT, ROW, HEAD = 4.4, 0.34, 1.4
#: share of the drawing's size that an axis of a frame is long
FRAME_AXIS_SHARE: Final = 0.12
MIN_BAR_AMOUNT: Final = 1e-6  #: an amount, m or rad, up to which bars show nothing
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
    height = max(MIN_HEIGHT, HEAD + ROW * count)
    figure = style.placed_figure(height, CLOSURE_WIDTH)
    look: Any = {"fontsize": 10, "fontweight": "bold", "va": "top"}
    figure.text(0.02, 0.98, style.label(title, 120), **look)
    _drawing(figure, closure, joints)
    _bars(figure.add_axes(BARS), closure)
    legend: Any = {"loc": "lower left", "ncols": 4, "bbox_to_anchor": (0.02, 0.0)}
    figure.legend(handles=_legend(closure), **legend)
    return figure


def _drawing(figure: Figure, closure: ClosestClosure, joints: list[str]) -> None:
    cloud = np.vstack([_points(closure.guess), _points(closure.nearest)])
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    if not len(cloud):
        look: Any = {"ha": "center", "color": style.GREY}
        figure.text(0.3, 0.5, "The machine has no place at its guess.", **look)
        return
    box = box_around(cloud)
    ends = units.from_si(closure.nearest.struts[:, 0], "mm")
    azimuth = clearest_azimuth(ends) if len(ends) else AZIMUTHS[0]
    x, y, right, top = DRAWING
    bounds = (x, y, right - x, top - y)
    axes: Any = figure.add_axes(bounds, projection="3d", proj_type="ortho")
    for shape, look in ((closure.guess, GUESS_LOOK), (closure.nearest, NEAREST_LOOK)):
        for line in shape.lines or tuple(shape.struts):
            axes.plot(*units.from_si(line, "mm").T, **look)
    _open_lines(axes, closure)
    _struts(axes, closure, joints)
    size = float((box[1] - box[0]).max())
    _frame(axes, np.zeros(3), np.eye(3), FRAME_AXIS_SHARE * size, BASE)
    tool = units.from_si(closure.nearest.tool, "mm")
    turned = closure.nearest.axes
    _frame(axes, tool, turned, FRAME_AXIS_SHARE * size, "tool point")
    set_axes(axes, box, azimuth)
    fit_to(figure, axes, box, DRAWING)


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


def _bars(axes: Axes, closure: ClosestClosure) -> None:
    """By how much each equation is missed, at the guess and at best."""
    guess, nearest = np.abs(closure.guess.equations), np.abs(closure.nearest.equations)
    rows = range(len(guess))
    finite = np.nan_to_num
    above, below = [k - 0.19 for k in rows], [k + 0.19 for k in rows]
    axes.barh(above, finite(guess), height=0.34, color=style.LIGHT)
    colours = [style.RED if k in closure.still_open else style.INK for k in rows]
    axes.barh(below, finite(nearest), height=0.34, color=colours)
    widest = max(
        float(finite(guess).max()), float(finite(nearest).max()), MIN_BAR_AMOUNT
    )
    axes.set_xlim(0.0, 1.45 * widest)
    if widest <= MIN_BAR_AMOUNT:
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
    look: Any = {"va": "center", "fontsize": 7, "color": colour}
    end = float(np.nan_to_num(value))
    axes.text(end, row, f" {_words(value) if phrase is None else phrase}", **look)


def _words(value: float) -> str:
    if value <= MIN_BAR_AMOUNT:
        return "0"
    return text.trimmed(value, 3) if np.isfinite(value) else "no value"


def _name(k: int, joints: tuple[str, ...]) -> str:
    """`2 (q2)`; of many joints the first ones."""
    if not joints:
        return f"{k + 1}"
    more = ", …" if len(joints) > 2 else ""
    return f"{k + 1} ({', '.join(joints[:2])}{more})"


def _legend(closure: ClosestClosure) -> list[Line2D]:
    from matplotlib.lines import Line2D

    entries: list[Any] = [
        Line2D([], [], label="at the guess", **GUESS_LOOK),  # type: ignore[arg-type]
        Line2D([], [], label="where the closure is met best", **NEAREST_LOOK),  # type: ignore[arg-type]
    ]
    if closure.still_open:
        entries.append(Line2D([], [], label="open", **OPEN_LOOK))  # type: ignore[arg-type]
    return entries
