"""Residuals of each run before and after the found effects are in the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from pkm_reports import style, words

MOST: Final = 9
COLUMNS: Final = 3
#: readings of a run up to which each has a marker of full size
FEW: Final = 60
AXIS: Final = {
    "circle": "angle [°]",
    "line": "way along the line [mm]",
    "points": "reading",
}


def draw(traces: Sequence[Mapping[str, Any]]) -> Figure:
    """A panel for each run: what calibration leaves, what the effects explain of it,
    and what is left then.
    """
    kept = chosen(traces)
    if not kept:
        return style.empty("No residuals are stored in this result.")
    columns = 2 if len(kept) == 4 else min(COLUMNS, len(kept))
    rows = math.ceil(len(kept) / columns)
    figure = style.figure(0.45 + 1.55 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    limits = _limits(kept)
    loads = len({t.get("payload_N") for t in kept}) > 1
    for axes, trace in zip(grid, kept, strict=False):
        _panel(axes, trace, limits[trace["unit"]], loads=loads)
    for axes in grid[len(kept) :]:
        axes.set_visible(False)
    for k, axes in enumerate(grid[: len(kept)]):
        axes.set_ylabel(
            f"[{words.unit(str(kept[k]['unit']))}]" if k % columns == 0 else ""
        )
        if k + columns >= len(kept):
            axes.set_xlabel(AXIS.get(str(kept[k]["kind"]), "reading"))
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def chosen(traces: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Up to MOST runs, those with the largest residuals before, in the order of the
    data.
    """
    known = [t for t in traces if np.isfinite(style.array(t.get("before") or [])).any()]
    ranked = sorted(range(len(known)), key=lambda k: -rms(known[k]["before"]))
    return [known[k] for k in sorted(ranked[:MOST])]


def rms(values: Any) -> float:
    """Root mean square of numbers from JSON."""
    found = style.array(values)
    return float(np.sqrt(np.nanmean(found**2))) if np.isfinite(found).any() else 0.0


def title(trace: Mapping[str, Any], *, loads: bool = False) -> str:
    """Set-up and run; the channel where it is not the only one that a set-up has, the
    payload where it varies.
    """
    name = f"{trace['setup']}, {trace['run']}"
    name += "" if trace["channel"] in ("length", "height") else f", {trace['channel']}"
    known = loads and trace.get("payload_N") is not None
    return f"{name}, {words.plain(trace['payload_N'], 4)} N" if known else name


def _limits(traces: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Half of the vertical range for each unit: the same in all panels, not ruled by a
    single outlier.
    """
    found: dict[str, float] = {}
    for unit in {str(t["unit"]) for t in traces}:
        mine = [t for t in traces if t["unit"] == unit]
        every = np.abs(
            np.concatenate(
                [
                    style.array(t[k])
                    for t in mine
                    for k in ("before", "after", "explained")
                ]
            )
        )
        spread = float(np.nanquantile(every, 0.98))
        largest = float(np.nanmax(every))
        found[unit] = 1.1 * (largest if largest < 3.0 * spread else 1.5 * spread) or 1.0
    return found


def _panel(axes: Axes, trace: Mapping[str, Any], limit: float, *, loads: bool) -> None:
    at = style.array(trace["at"])
    before, after, explained = (
        style.array(trace[k]) for k in ("before", "after", "explained")
    )
    unknown = style.array(trace.get("unexplained") or [])
    size = 2.6 if len(at) <= FEW else 1.5
    line = "-" if trace["kind"] != "points" else ""
    axes.axhline(0.0, color=style.INK, lw=0.6)
    axes.plot(
        at,
        np.clip(before, -limit, limit),
        "o",
        ms=size,
        color=style.GREY,
        label="before",
    )
    explains = np.clip(explained, -limit, limit)
    mark = "" if line else "_"
    if np.any(explains):
        axes.plot(
            at,
            explains,
            line,
            marker=mark,
            ms=5,
            lw=1.2,
            color=style.ORANGE,
            label="explained by the effects",
        )
    if np.any(unknown):
        axes.plot(
            at,
            np.clip(unknown, -limit, limit),
            line,
            marker=mark,
            ms=5,
            color=style.PINK,
            label="unknown form",
        )
    if np.any(explains):
        axes.plot(
            at,
            np.clip(after, -limit, limit),
            "o",
            ms=size,
            color=style.BLUE,
            label="after",
        )
    axes.set_ylim(-limit, limit)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    if trace["kind"] == "circle":
        axes.set_xlim(0.0, 360.0)
        axes.xaxis.set_major_locator(MultipleLocator(90.0))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    last = f" to {words.num(rms(after), 2)}" if np.any(explains) else ""
    told = f"{words.num(rms(before), 2)}{last} {words.unit(str(trace['unit']))}"
    axes.set_title(
        f"{style.safe(title(trace, loads=loads), 36)}\nrms {told}",
        fontsize=7,
        fontweight="normal",
    )
