"""Efficiency of the design for each criterion by all others, as a shaded table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.design import CRITERIA
from oed.result import CriterionComparison, DesignSection
from pkm_reports import missing, style, text
from pkm_reports.missing import or_nan

#: share of the colour scale above which letters are white
DARK: Final = 0.55
#: least |log ratio| from which a number of directions is computed
LEAST_LOG: Final = 1e-4


def draw(design: DesignSection) -> Figure:
    """A row for each criterion, a column for the design made for it."""
    table = efficiencies(design.compared, design.directions)
    if not np.isfinite(table).any():
        return style.empty("No designs for further criteria are stored in this result.")
    names = [entry.name for entry in design.compared]
    width = min(style.WIDTH, 2.6 + 0.62 * len(names))
    figure = style.figure(0.75 + 0.3 * len(names), width)
    axes = figure.subplots()
    low = min(0.5, math.floor(10.0 * float(np.nanmin(table))) / 10.0)
    shade: Any = {
        "cmap": style.AMOUNT,
        "vmin": low,
        "vmax": 1.0,
        "aspect": "auto",
    }
    image = axes.imshow(np.ma.masked_invalid(np.minimum(table, 1.0)), **shade)
    _write_percentages(axes, table, low)
    style.fixed_ticks(axes, "x", range(len(names)), names)
    style.fixed_ticks(axes, "y", range(len(names)), names)
    axes.grid(False)
    axes.set(xlabel="plan designed for …", ylabel="… judged by")
    bar: Any = figure.colorbar(
        image,
        ax=axes,
        label="efficiency",
        pad=0.02,
    )
    bar.outline.set_visible(False)
    return figure


def efficiencies(compared: Sequence[CriterionComparison], directions: int = 0) -> Array:
    """phi by criterion i of design j over phi of the design for i (criteria, designs).

    Plans are taken to have the same number of readings. NaN where a plan leaves a
    direction unseen, or where the stored numbers do not give phi.
    """
    names = [entry.name for entry in compared]
    table = np.full((len(names), len(names)), np.nan)
    for i, entry in enumerate(compared):
        values = {name: missing.entry(entry.values, name) for name in names}
        size = _counted_directions(entry, values, names[0], directions)
        for j, name in enumerate(names):
            table[i, j] = _ratio(entry.name, values[name], values[entry.name], size)
        table[i, i] = 1.0
    return table


def _ratio(
    criterion: str,
    value: float,
    best: float,
    directions: float,
) -> float:
    """phi of a design over phi of the best one; NaN for a criterion of another version."""
    known = CRITERIA.entry(criterion)
    return math.nan if known is None else known.phi_ratio(value, best, directions)


def _counted_directions(
    entry: CriterionComparison,
    values: Mapping[str, float],
    main: str,
    directions: int,
) -> float:
    """What log det is divided by: the number of directions that count.

    It follows from the bound or the gain, where these differ from the value itself.
    """
    known = CRITERIA.entry(entry.name)
    if known is None or known.form is None:  # a weighted mean of log phi
        return 1.0
    below_bound = entry.value - or_nan(entry.bound)
    above_main = values[entry.name] - values[main]
    sizes = [
        _directions_from(below_bound, or_nan(entry.efficiency)),
        _directions_from(above_main, or_nan(entry.gain)),
    ]
    for size in sizes:
        if math.isfinite(size) and size > 0.0:
            return size
    judges_all = known.needs == "none"
    return float(directions) if judges_all and directions > 0 else math.nan


def _directions_from(difference: float, ratio: float) -> float:
    """Directions for which a difference of log det is a ratio of phi; NaN if unclear."""
    if not ratio > 0.0 or abs(math.log(ratio)) <= LEAST_LOG:
        return math.nan
    return difference / math.log(ratio)


def _write_percentages(axes: Axes, table: Array, low: float) -> None:
    """Percentages in the cells; a dash where there is none."""
    for (i, j), share in np.ndenumerate(table):
        dark = (share - low) / (1.0 - low) > DARK
        ink = style.INK if np.isfinite(share) else style.GREY
        letters: Any = {"ha": "center", "va": "center", "fontsize": 7.5}
        letters["color"] = "white" if dark else ink
        letters["fontweight"] = "bold" if i == j else "normal"
        axes.text(j, i, text.percent(share), **letters)
