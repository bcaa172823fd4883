"""3-D axes with one scale on all axes, fitted to a rectangle of the figure."""

from __future__ import annotations

import itertools
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped]

from oed.base import Array

#: lower and upper corner (3,) of what is shown, mm
Box = tuple[Array, Array]
#: left, bottom, right and top of a rectangle, as shares of the figure
Rectangle = tuple[float, float, float, float]
VIEW: Final[dict[str, float]] = {"elev": 20.0, "azim": -58.0}
#: azimuths that a labelled drawing can be seen from, the usual one first
AZIMUTHS: Final[tuple[float, ...]] = (-58.0, *map(float, range(-85, -4, 5)))
#: width and height of a label, relative to one another
LETTERING: Final = np.array([3.0, 1.0])
#: least depth of a box, as a share of its largest side, and room around it
LEAST_DEPTH, MARGIN = 0.3, 1.06
#: share of the largest side below which an axis has few ticks
SHORT: Final = 0.6
#: letters do not scale with the box, so fitting takes more than one step
FITTING_STEPS: Final = 3


def box_around(cloud: Array) -> Box:
    """A box around points (n, 3); a flat one gets some depth."""
    low, high = np.nanmin(cloud, axis=0), np.nanmax(cloud, axis=0)
    longest = max(float(np.max(high - low)), 1.0)
    size = MARGIN * np.maximum(high - low, LEAST_DEPTH * longest)
    return (low + high - size) / 2.0, (low + high + size) / 2.0


def clearest_azimuth(points: Array) -> float:
    """Azimuth, deg, that spreads points (n, 3) widest in the picture; the usual if few.

    The spread is the least distance of two points, as drawn.
    """
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
        short = size[k] < SHORT * size.max()
        getattr(axes, f"set_{name}lim")(box[0][k], box[1][k])
        set_label = getattr(axes, f"set_{name}label")
        set_label(f"{name} [mm]", labelpad=-2.0 if short else 0.0)
        axis = getattr(axes, f"{name}axis")
        ticks = MaxNLocator(2 if short else 4, steps=[1, 2, 2.5, 5, 10])
        axis.set_major_locator(ticks)
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_tick_params(pad=-1.0, labelsize=6.5)
    axes.zaxis.set_tick_params(pad=1.0)
    axes.set_box_aspect(size)
    axes.view_init(elev=VIEW["elev"], azim=azimuth)


def fit_to(
    figure: Figure,
    axes: Any,
    box: Box,
    room: Rectangle,
) -> None:
    """Move and scale the axes until box, ticks and labels fill the rectangle.

    How much of its rectangle a 3-D box fills depends on its shape and on the view.
    """
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


def _extent(
    figure: Figure,
    axes: Any,
    box: Box,
    renderer: Any,
) -> Array:
    """Corners (2, 2) of what the axes cover, as shares of the figure."""
    covered = [
        axis.get_tightbbox(renderer) for axis in (axes.xaxis, axes.yaxis, axes.zaxis)
    ]
    covered.append(_outline(axes, box))
    to_shares = figure.transFigure.inverted()
    return to_shares.transform(Bbox.union(covered).get_points())


def _outline(axes: Any, box: Box) -> Bbox:
    """Rectangle on the canvas around the eight corners of the 3-D box."""
    corners = np.array(list(itertools.product(*zip(*box, strict=True))))
    x, y, _ = proj3d.proj_transform(*corners.T, axes.get_proj())
    pixels = axes.transData.transform(np.column_stack([x, y]))
    return Bbox([pixels.min(axis=0), pixels.max(axis=0)])
