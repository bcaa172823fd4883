"""Readings along circles and lines: measured, predicted with interval, compensated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from oed.base import Array
from oed.result import RunCurve
from pkm_reports import missing, style, text

#: runs that are drawn
MOST: Final = 4
#: readings of a run up to which marks are of full size
FEW: Final = 60
AXIS_LABELS: Final = {"circle": "angle [°]", "line": "distance along the line [mm]"}
INTERVAL: Final = "95 % interval"


def draw(curves: Sequence[RunCurve], *, after: bool = False) -> Figure:
    """A row for each run: from nominal, from the prediction, after compensation.

    after  whether the readings were taken after compensation
    """
    shown = choose(curves)
    if not shown:
        return style.empty("No readings along runs are stored in this result.")
    columns = 3 if any(curve.compensated for curve in shown) else 2
    figure = style.figure(0.6 + 1.6 * len(shown))
    grid = figure.subplots(len(shown), columns, squeeze=False)
    moment = "after" if after else "before"
    titles = [
        f"{moment.capitalize()} compensation",
        "Measured − predicted",
        "After compensation",
    ]
    for axes, title in zip(grid[0], titles, strict=False):
        axes.set_title(title)
    for row, curve in zip(grid, shown, strict=True):
        _row(row, curve)
    style.legend_below(figure, style.legend_entries(grid[:, :2].ravel()), 3)
    return figure


def choose(curves: Sequence[RunCurve]) -> list[RunCurve]:
    """Up to MOST runs with the largest departures, in the order of the data."""
    sizes = [_largest(missing.array(curve.measured)) for curve in curves]
    ranked = sorted(range(len(curves)), key=lambda k: -sizes[k])
    return [curves[k] for k in sorted(ranked[:MOST])]


def _largest(values: Array) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0))


def _row(row: Sequence[Axes], curve: RunCurve) -> None:
    along = missing.array(curve.at)
    measured, predicted = missing.array(curve.measured), missing.array(curve.predicted)
    half = missing.array(curve.half_widths)
    _predicted(row[0], along, predicted, half)
    _measured(row[0], along, measured)
    _band(row[1], along, np.zeros(len(along)), half)
    _measured(row[1], along, measured - predicted)
    if curve.compensated:
        remaining = missing.array(curve.compensated)
        half_after = missing.array(curve.compensated_half_widths)
        _predicted(row[2], along, remaining, half_after)
    elif len(row) > 2:
        style.hide(row[2:])
    for axes in row:
        axes.axhline(0.0, color=style.INK, lw=0.6)
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.set_xlabel(AXIS_LABELS[curve.kind])
        if curve.kind == "circle":
            axes.set_xlim(0.0, 360.0)
            axes.xaxis.set_major_locator(MultipleLocator(90.0))
    name = style.label(f"{curve.setup}, {curve.run}", 24)
    row[0].set_ylabel(f"{name}\n{curve.channel} [{text.unit_symbol(curve.unit)}]")


def _measured(axes: Axes, along: Array, values: Array) -> None:
    look: Any = {"ls": "", "marker": "o", "color": style.BLUE}
    axes.plot(
        along, values, ms=2.6 if len(along) <= FEW else 1.4, label="measured", **look
    )


def _predicted(axes: Axes, along: Array, values: Array, half: Array) -> None:
    _band(axes, along, values, half)
    axes.plot(along, values, color=style.ORANGE, lw=1.1, label="predicted")


def _band(axes: Axes, along: Array, values: Array, half: Array) -> None:
    look: Any = {"color": style.LIGHT, "lw": 0.0, "label": INTERVAL}
    axes.fill_between(along, values - half, values + half, **look)


# -- in words --------------------------------------------------------------------------


def caption(curves: Sequence[RunCurve]) -> str:
    """What the figure shows, and the largest difference from the prediction."""
    inside, count = coverage(curves)
    difference, unit = largest_difference(curves)
    sentences = [
        "Readings along circles and lines, as departures from those of the nominal"
        " machine.",
        f"{inside} of {count} lie inside their 95 % interval (parameters and noise); the"
        f" largest difference from the prediction is {text.quantity(difference, unit)}.",
    ]
    if any(curve.compensated for curve in curves):
        sentences.append(
            "After compensation the instrument still reads what no drive corrects and the"
            " errors of its set-up; a place that the machine teaches is taught anew."
        )
    more = len(curves) - MOST
    if more > 0:
        sentences.append(f"{more} more are in result.json.")
    return " ".join(sentences)


def coverage(curves: Sequence[RunCurve]) -> tuple[int, int]:
    """Number of readings inside their interval, and of all."""
    inside = count = 0
    for curve in curves:
        error = np.abs(_difference(curve))
        inside += int((error <= missing.array(curve.half_widths)).sum())
        count += len(error)
    return inside, count


def largest_difference(curves: Sequence[RunCurve]) -> tuple[float, str]:
    """Largest measured less predicted reading, of those in the unit of the first."""
    unit = curves[0].unit
    sizes = [_largest(_difference(c)) for c in curves if c.unit == unit]
    return max(sizes, default=math.nan), unit


def _difference(curve: RunCurve) -> Array:
    return missing.array(curve.measured) - missing.array(curve.predicted)
