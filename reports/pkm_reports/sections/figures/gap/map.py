"""Residuals over the workspace, before and after the effects are in the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.base import Array
from oed.result import Spot
from pkm_reports import missing, style, text

#: two axes of the base frame to look along: across and up
View = tuple[int, int]
#: extent of an axis, as a share of the largest, from which it has a view of its own
FLAT: Final = 0.05
AXES: Final = ("x", "y", "z")
#: inches of a row: for a square view, and limits
ROW_HEIGHT, LOWEST_ROW, HIGHEST_ROW = 2.5, 1.2, 2.6
#: quantile of the residuals that ends the colour scale
TOP_QUANTILE: Final = 0.98


def draw(spots: Sequence[Spot], unit: str) -> Figure:
    """Places coloured by their rms residual: a row for each view, before and after.

    Where the model does not change there is one column.
    """
    if not spots:
        return style.empty("No places are stored in this result.")
    places = missing.table([spot.at for spot in spots])
    columns = _columns(spots)
    pairs = views(places)
    heights = [_row_height(places, pair) for pair in pairs]
    width = style.WIDTH if len(columns) > 1 else 0.6 * style.WIDTH
    figure = style.figure(0.5 + sum(heights), width=width)
    shape = (len(pairs), len(columns))
    grid = figure.subplots(*shape, squeeze=False, height_ratios=heights)
    before = columns[0][1]
    top = float(np.nanquantile(before, TOP_QUANTILE)) or 1.0
    norm = Normalize(0.0, top)
    for row, pair in zip(grid, pairs, strict=True):
        for axes, (_, values) in zip(row, columns, strict=True):
            image = _panel(axes, places, pair, values, norm)
    for axes, (name, values) in zip(grid[0], columns, strict=True):
        rms = text.number(np.sqrt(np.nanmean(values**2)), 3)
        axes.set_title(f"{name}: rms {rms}", fontsize=8)
    beyond = float(np.nanmax(before)) > 1.001 * top
    bar_look: Any = {"shrink": 0.8, "pad": 0.02}
    bar_look["extend"] = "max" if beyond else "neither"
    panels = grid.ravel().tolist()
    bar: Any = figure.colorbar(
        image,
        ax=panels,
        label=_scale_label(unit),
        **bar_look,
    )
    bar.outline.set_visible(False)
    bar.ax.yaxis.set_major_locator(MaxNLocator(5))
    return figure


def _columns(spots: Sequence[Spot]) -> list[tuple[str, Array]]:
    """Title and residual of each place (n,): before and after, or one of both."""
    before = missing.array([spot.before for spot in spots])
    after = missing.array([spot.after for spot in spots])
    if np.array_equal(before, after, equal_nan=True):
        return [("residual", before)]
    return [("before", before), ("after", after)]


def _scale_label(unit: str) -> str:
    if unit == "sigma":
        return "residual [times the stated noise]"
    return f"rms residual [{text.unit_symbol(unit)}]"


def views(places: Array) -> list[View]:
    """Pairs of axes to look along; two where the places (n, 3) fill the space."""
    spread = np.ptp(places, axis=0)
    order = [int(k) for k in np.argsort(-spread, kind="stable")]
    if spread[order[2]] > FLAT * spread[order[0]]:
        return [(0, 1), (0 if spread[0] >= spread[1] else 1, 2)]
    across, up = sorted(order[:2])
    return [(across, up)]


def _row_height(places: Array, view: View) -> float:
    """Inches of a row, so that lengths are alike both ways, within reason."""
    across, up = (max(float(np.ptp(places[:, k])), 1e-9) for k in view)
    return float(np.clip(ROW_HEIGHT * up / across, LOWEST_ROW, HIGHEST_ROW)) + 0.35


def _panel(
    axes: Axes, places: Array, view: View, values: Array, norm: Normalize
) -> Any:
    order = np.argsort(values)  # large residuals on top
    across, up = places[order, view[0]], places[order, view[1]]
    look: Any = {
        "cmap": style.AMOUNT,
        "norm": norm,
        "ec": style.GREY,
        "lw": 0.3,
    }
    look["s"] = float(np.clip(3000.0 / len(places), 6.0, 30.0))
    image = axes.scatter(across, up, c=values[order], **look)
    axes.set(xlabel=f"{AXES[view[0]]} [mm]", ylabel=f"{AXES[view[1]]} [mm]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return image
