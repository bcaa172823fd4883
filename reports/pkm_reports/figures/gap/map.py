"""Where in the workspace the residual is large, before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.arrays import Array
from pkm_reports import style, words

#: extent of an axis, as a share of the largest, from which it is drawn
FLAT: Final = 0.05
AXES: Final = ("x", "y", "z")


def draw(spots: Sequence[Mapping[str, Any]], unit: str) -> Figure:
    """Places of the tool coloured by the rms residual there: a row for each view,
    before at left and after at right.

    Where nothing changes there is one column.
    """
    if not spots:
        return style.empty("No places are stored in this result.")
    at = style.array([s["at"] for s in spots])
    parts = [
        (name, style.array([s.get(name) for s in spots]))
        for name in ("before", "after")
    ]
    if np.array_equal(parts[0][1], parts[1][1], equal_nan=True):
        parts = [("residual", parts[0][1])]
    pairs = views(at)
    heights = [_height(at, pair) for pair in pairs]
    figure = style.figure(
        0.5 + sum(heights), width=style.WIDTH if len(parts) > 1 else 0.6 * style.WIDTH
    )
    grid = figure.subplots(len(pairs), len(parts), squeeze=False, height_ratios=heights)
    top = float(np.nanquantile(parts[0][1], 0.98)) or 1.0
    norm = Normalize(0.0, top)
    for k, pair in enumerate(pairs):
        for axes, (name, values) in zip(grid[k], parts, strict=True):
            drawn = _panel(axes, at, pair, values, norm)
            if k == 0:
                axes.set_title(
                    f"{name}: rms {words.num(np.sqrt(np.nanmean(values**2)), 3)}",
                    fontsize=8,
                )
    told = (
        "residual [times the stated noise]"
        if unit == "sigma"
        else f"rms residual [{words.unit(unit)}]"
    )
    over = "max" if float(np.nanmax(parts[0][1])) > 1.001 * top else "neither"
    bar: Any = figure.colorbar(
        drawn, ax=grid.ravel().tolist(), label=told, shrink=0.8, pad=0.02, extend=over
    )
    bar.outline.set_visible(False)
    bar.ax.yaxis.set_major_locator(MaxNLocator(5))
    return figure


def views(at: Array) -> list[tuple[int, int]]:
    """Pairs of axes to look along: across and up; a second view where the places are
    spread in all three.
    """
    spread = np.ptp(at, axis=0)
    order = [int(k) for k in np.argsort(-spread, kind="stable")]
    first = tuple(sorted(order[:2]))
    found = [(first[0], first[1])]
    if spread[order[2]] > FLAT * spread[order[0]]:
        found = [(0, 1), (0 if spread[0] >= spread[1] else 1, 2)]
    return found


def _height(at: Array, pair: tuple[int, int]) -> float:
    """Inches of a row, so that lengths are alike both ways, within reason."""
    wide, high = (max(float(np.ptp(at[:, k])), 1e-9) for k in pair)
    return float(np.clip(2.5 * high / wide, 1.2, 2.6)) + 0.35


def _panel(
    axes: Axes, at: Array, pair: tuple[int, int], values: Array, norm: Normalize
) -> Any:
    order = np.argsort(values)  # the large ones on top
    across, up = at[order, pair[0]], at[order, pair[1]]
    size = float(np.clip(3000.0 / len(at), 6.0, 30.0))
    drawn = axes.scatter(
        across,
        up,
        c=values[order],
        cmap=style.AMOUNT,
        norm=norm,
        s=size,
        ec=style.GREY,
        lw=0.3,
    )
    axes.set(xlabel=f"{AXES[pair[0]]} [mm]", ylabel=f"{AXES[pair[1]]} [mm]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    return drawn
