"""Circles as a ball bar shows them: the residual magnified about the circle, both ways
of travel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from pkm_reports import style, words
from pkm_reports.figures.gap import trace as gap_trace

MOST: Final = 3
#: the residual's largest swing as a share of the drawn radius
SWING: Final = 0.45
WAYS: Final = {1: ("forward", "-", style.BLUE), -1: ("backward", "--", style.RED)}
Key = tuple[str, str, str, float | None]


def draw(traces: Sequence[Mapping[str, Any]]) -> Figure:
    """A column for each circle: above what calibration leaves, below what is left with
    the effects, if any.
    """
    kept = circles(traces)
    if not kept:
        return style.empty("No run of these readings is a circle.")
    parts = (
        ["before", "after"]
        if any(np.any(style.array(t["explained"])) for t in traces)
        else ["before"]
    )
    figure = style.figure(
        0.5 + 2.3 * len(parts), width=min(style.WIDTH, 2.25 * len(kept) + 0.4)
    )
    grid: Any = figure.subplots(
        len(parts), len(kept), squeeze=False, subplot_kw={"projection": "polar"}
    )
    for column, (key, runs) in enumerate(kept.items()):
        largest = (
            max(float(np.nanmax(np.abs(style.array(t["before"])))) for t in runs) or 1.0
        )
        scale = _step(largest)
        for row, part in enumerate(parts):
            _panel(grid[row, column], runs, part, largest)
            what = part if len(parts) > 1 else "residual"
            told = (
                f"{what}: rms {words.num(_rms(runs, part), 2)}"
                f" {words.unit(str(runs[0]['unit']))}"
            )
            head = f"{style.safe(_name(key), 26)}\n" if row == 0 else ""
            grid[row, column].set_title(
                head + told, fontsize=7, fontweight="normal", loc="center", pad=8
            )
        _ruler(grid[-1, column], scale, largest, words.unit(str(runs[0]["unit"])))
    handles, labels = _unique(grid.ravel())
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def circles(traces: Sequence[Mapping[str, Any]]) -> dict[Key, list[Mapping[str, Any]]]:
    """Up to MOST circles with all their passes, those with the largest residuals
    before, in the order of the data.
    """
    found: dict[Key, list[Mapping[str, Any]]] = {}
    for t in traces:
        if t["kind"] == "circle":
            found.setdefault(
                (
                    str(t["setup"]),
                    str(t["base"]),
                    str(t["channel"]),
                    t.get("payload_N"),
                ),
                [],
            ).append(t)
    ranked = sorted(found, key=lambda key: -_rms(found[key], "before"))[:MOST]
    return {key: runs for key, runs in found.items() if key in ranked}


def _name(key: Key) -> str:
    load = "" if key[3] is None else f", {words.plain(key[3], 3)} N"
    return f"{key[0]}, {key[1]}{load}"


def _rms(runs: Sequence[Mapping[str, Any]], part: str) -> float:
    return float(np.sqrt(np.mean([gap_trace.rms(t[part]) ** 2 for t in runs])))


def _panel(
    axes: Any, runs: Sequence[Mapping[str, Any]], part: str, largest: float
) -> None:
    around = np.linspace(0.0, 2.0 * math.pi, 181)
    axes.plot(around, np.ones_like(around), color=style.INK, lw=0.6)
    for trace in runs:
        at, values = np.radians(style.array(trace["at"])), style.array(trace[part])
        label, line, colour = WAYS.get(
            trace.get("direction") or 0, ("direction unknown", "-", style.GREY)
        )
        closed = np.append(np.arange(len(at)), 0) if _whole(at) else np.arange(len(at))
        radius = np.clip(1.0 + SWING * values[closed] / largest, 0.05, 1.6)
        axes.plot(
            at[closed],
            radius,
            line,
            color=colour,
            lw=0.9,
            marker="o",
            ms=1.4,
            label=label,
        )
    axes.set_rlim(0.0, 1.6)
    axes.yaxis.set_major_locator(FixedLocator([1.0 - SWING, 1.0, 1.0 + SWING]))
    axes.set_yticklabels([])
    axes.xaxis.set_major_locator(
        FixedLocator(np.radians([0.0, 90.0, 180.0, 270.0]).tolist())
    )
    axes.set_xticklabels(["0°", "90°", "180°", "270°"], fontsize=6)
    axes.tick_params(axis="x", pad=-3)
    axes.spines["polar"].set_visible(False)


def _whole(at: Any) -> bool:
    """Whether the readings go all the way round."""
    gaps = np.diff(np.append(np.sort(at), np.min(at) + 2.0 * math.pi))
    return bool(gaps.max() < 4.0 * np.median(gaps) + 1e-9)


def _ruler(axes: Any, scale: float, largest: float, unit: str) -> None:
    """What a radial step is worth, in the middle of the circle."""
    length = SWING * scale / largest
    axes.plot([0.0, 0.0], [0.0, length], color=style.INK, lw=1.8, solid_capstyle="butt")
    axes.text(
        math.pi * 0.75,
        0.16,
        f"{words.plain(scale, 2)} {unit}",
        ha="center",
        va="center",
        fontsize=6.5,
    )


def _step(largest: float) -> float:
    """1, 2 or 5 times a power of ten, at most `largest`."""
    power = 10.0 ** math.floor(math.log10(largest))
    return max(
        k * power for k in (1.0, 2.0, 5.0) if k * power <= largest * (1.0 + 1e-9)
    )


def _unique(panels: Sequence[Any]) -> tuple[list[Any], list[str]]:
    """Legend entries of all panels, each once."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)
