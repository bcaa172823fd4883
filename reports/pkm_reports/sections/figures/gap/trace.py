"""Residuals of each run, before and after the effects are in the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from oed.base import Array
from oed.result import Trace
from pkm_reports import missing, style, text

MOST: Final = 9
MOST_COLUMNS: Final = 3
#: readings of a run up to which each has a mark of full size
FEW: Final = 60
#: quantile of the residuals, and the factor above it that counts as an outlier
QUANTILE, FAR = 0.98, 3.0
#: channels that set-ups have alone, so that a title need not name them
SINGLE_CHANNELS: Final = ("length", "height")
AXIS_LABELS: Final = {"circle": "angle [°]", "line": "distance along the line [mm]"}


def draw(traces: Sequence[Trace]) -> Figure:
    """A panel for each run: residuals before, explained part, residuals after."""
    shown = choose(traces)
    if not shown:
        return style.empty("No residuals are stored in this result.")
    columns = 2 if len(shown) == 4 else min(MOST_COLUMNS, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = style.figure(0.45 + 1.55 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    limits = _limits(shown)
    loads = len({trace.payload for trace in shown}) > 1
    for k, (axes, trace) in enumerate(zip(grid, shown, strict=False)):
        _panel(axes, trace, limits[trace.unit])
        _set_title(axes, trace, loads=loads)
        unit = text.unit_symbol(trace.unit)
        axes.set_ylabel(f"[{unit}]" if k % columns == 0 else "")
        if k + columns >= len(shown):
            axes.set_xlabel(AXIS_LABELS.get(trace.kind, "reading"))
    style.hide(grid[len(shown) :])
    entries = style.legend_entries(grid[:1])
    style.legend_below(figure, entries, len(entries))
    return figure


def choose(traces: Sequence[Trace]) -> list[Trace]:
    """Up to MOST runs with the largest residuals before, in the order of the data."""
    measured = [trace for trace in traces if missing.finite(trace.before)]
    sizes = [rms(missing.array(trace.before)) for trace in measured]
    ranked = sorted(range(len(measured)), key=lambda k: -sizes[k])
    return [measured[k] for k in sorted(ranked[:MOST])]


def rms(values: Array) -> float:
    """Root mean square of the finite values; 0 where there is none."""
    if not np.isfinite(values).any():
        return 0.0
    return float(np.sqrt(np.nanmean(values**2)))


def largest(values: Sequence[float | None]) -> float:
    """Largest size of the finite values."""
    return max(map(abs, missing.finite(values)), default=0.0)


def title(trace: Trace, *, loads: bool = False) -> str:
    """Set-up and run, with the channel and the payload (`loads`) where they matter."""
    name = f"{trace.setup}, {trace.run}"
    if trace.channel not in SINGLE_CHANNELS:
        name += f", {trace.channel}"
    if loads and trace.payload is not None:
        name += f", {text.trimmed(trace.payload, 4)} N"
    return name


def _limits(traces: Sequence[Trace]) -> dict[str, float]:
    """Half of the vertical range for each unit, the same in all panels.

    A single outlier does not rule it.
    """
    limits: dict[str, float] = {}
    for unit in {trace.unit for trace in traces}:
        of_unit = [trace for trace in traces if trace.unit == unit]
        sizes = np.abs(np.concatenate([_all_values(trace) for trace in of_unit]))
        spread = float(np.nanquantile(sizes, QUANTILE))
        top = float(np.nanmax(sizes))
        limits[unit] = 1.1 * (top if top < FAR * spread else 1.5 * spread) or 1.0
    return limits


def _all_values(trace: Trace) -> Array:
    return missing.array([*trace.before, *trace.after, *trace.explained])


def _panel(axes: Axes, trace: Trace, limit: float) -> None:
    along = missing.array(trace.at)
    explained = missing.array(trace.explained)
    unexplained = missing.array(trace.unexplained)
    marks: Any = {
        "ls": "",
        "marker": "o",
        "ms": 2.6 if len(along) <= FEW else 1.5,
    }
    joined = trace.kind != "points"
    lines: Any = {
        "ls": "-" if joined else "",
        "marker": "" if joined else "_",
        "ms": 5,
    }

    def plot(values: Array, label: str, **look: Any) -> None:
        axes.plot(
            along,
            np.clip(values, -limit, limit),
            label=label,
            **look,
        )

    axes.axhline(0.0, color=style.INK, lw=0.6)
    plot(
        missing.array(trace.before),
        "before",
        color=style.GREY,
        **marks,
    )
    if np.any(explained):
        label = "explained by the effects"
        plot(explained, label, lw=1.2, color=style.ORANGE, **lines)
    if np.any(unexplained):
        plot(unexplained, "unknown form", color=style.PINK, **lines)
    if np.any(explained):
        plot(
            missing.array(trace.after),
            "after",
            color=style.BLUE,
            **marks,
        )
    axes.set_ylim(-limit, limit)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    if trace.kind == "circle":
        axes.set_xlim(0.0, 360.0)
        axes.xaxis.set_major_locator(MultipleLocator(90.0))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))


def _set_title(axes: Axes, trace: Trace, *, loads: bool) -> None:
    """Name of the run, and its rms before and after."""
    size = text.number(rms(missing.array(trace.before)), 2)
    if any(trace.explained):
        size += f" to {text.number(rms(missing.array(trace.after)), 2)}"
    name = style.label(title(trace, loads=loads), 36)
    unit = text.unit_symbol(trace.unit)
    letters: Any = {"fontsize": 7, "fontweight": "normal"}
    axes.set_title(f"{name}\nrms {size} {unit}", **letters)
