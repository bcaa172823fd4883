"""Circles as a ball bar shows them: residuals magnified about the circle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from oed.base import Array
from oed.result import Trace
from pkm_reports import missing, style, text
from pkm_reports.sections.figures.gap import trace as gap_trace

MOST: Final = 3
#: the largest residual as a share of the drawn radius, and the outer radius
SWING, OUTER = 0.45, 1.6
#: label, line and colour of a direction of travel
DIRECTIONS: Final = {
    1: ("forward", "-", style.BLUE),
    -1: ("backward", "--", style.RED),
}
NO_DIRECTION: Final = ("direction unknown", "-", style.GREY)
QUARTERS: Final = np.radians([0.0, 90.0, 180.0, 270.0]).tolist()
#: set-up, name without its pass, channel, payload (N) of a circle
CircleKey = tuple[str, str, str, float | None]
#: before or after the effects are in the model
When = Literal["before", "after"]


def draw(traces: Sequence[Trace]) -> Figure:
    """A column for each circle: above before, below after, where effects were found."""
    drawn = circles(traces)
    if not drawn:
        return style.empty("No run of these readings is a circle.")
    rows: list[When] = ["before", "after"] if explains(traces) else ["before"]
    width = min(style.WIDTH, 2.25 * len(drawn) + 0.4)
    figure = style.figure(0.5 + 2.3 * len(rows), width=width)
    polar: Any = {"projection": "polar"}
    shape = (len(rows), len(drawn))
    grid: Any = figure.subplots(*shape, squeeze=False, subplot_kw=polar)
    for column, (key, runs) in zip(grid.T, drawn.items(), strict=True):
        largest = max(gap_trace.largest(run.before) for run in runs) or 1.0
        unit = text.unit_symbol(runs[0].unit)
        for axes, when in zip(column, rows, strict=True):
            _panel(axes, runs, when, largest)
            name = when if len(rows) > 1 else "residual"
            title = f"{name}: rms {text.number(_rms(runs, when), 2)} {unit}"
            if when == "before":
                title = f"{style.label(_name(key), 26)}\n{title}"
            letters: Any = {"fontsize": 7, "fontweight": "normal"}
            axes.set_title(title, loc="center", pad=8, **letters)
        _ruler(column[-1], largest, unit)
    entries = style.legend_entries(grid.ravel())
    style.legend_below(figure, entries, len(entries))
    return figure


def circles(traces: Sequence[Trace]) -> dict[CircleKey, list[Trace]]:
    """Up to MOST circles with all their passes, in the order of the data.

    Circles with the largest residuals are taken first.
    """
    passes: dict[CircleKey, list[Trace]] = {}
    for trace in traces:
        if trace.kind == "circle":
            passes.setdefault(circle_key(trace), []).append(trace)
    ranked = sorted(passes, key=lambda key: -_rms(passes[key], "before"))[:MOST]
    return {key: runs for key, runs in passes.items() if key in ranked}


def circle_key(trace: Trace) -> CircleKey:
    """What the passes of one circle have in common."""
    return trace.setup, trace.base, trace.channel, trace.payload


def explains(traces: Sequence[Trace]) -> bool:
    """Whether the effects of the diagnosis explain any residual."""
    return any(value != 0.0 for trace in traces for value in trace.explained)


def _name(key: CircleKey) -> str:
    setup, base, _, payload = key
    load = "" if payload is None else f", {text.trimmed(payload, 3)} N"
    return f"{setup}, {base}{load}"


def _residuals(trace: Trace, when: When) -> Array:
    return missing.array(trace.before if when == "before" else trace.after)


def _rms(runs: Sequence[Trace], when: When) -> float:
    squares = [gap_trace.rms(_residuals(run, when)) ** 2 for run in runs]
    return float(np.sqrt(np.mean(squares)))


def _panel(
    axes: Any,
    runs: Sequence[Trace],
    when: When,
    largest: float,
) -> None:
    around = np.linspace(0.0, 2.0 * math.pi, 181)
    axes.plot(
        around,
        np.ones_like(around),
        color=style.INK,
        lw=0.6,
    )
    for run in runs:
        angle, residuals = np.radians(missing.array(run.at)), _residuals(run, when)
        order = np.arange(len(angle))
        if _goes_round(angle):
            order = np.append(order, 0)
        radius = np.clip(1.0 + SWING * residuals[order] / largest, 0.05, OUTER)
        label, line, colour = DIRECTIONS.get(run.direction or 0, NO_DIRECTION)
        look: Any = {
            "color": colour,
            "lw": 0.9,
            "marker": "o",
            "ms": 1.4,
        }
        axes.plot(angle[order], radius, line, label=label, **look)
    axes.set_rlim(0.0, OUTER)
    axes.yaxis.set_major_locator(FixedLocator([1.0 - SWING, 1.0, 1.0 + SWING]))
    axes.set_yticklabels([])
    axes.xaxis.set_major_locator(FixedLocator(QUARTERS))
    axes.set_xticklabels(["0°", "90°", "180°", "270°"], fontsize=6)
    axes.tick_params(axis="x", pad=-3)
    axes.spines["polar"].set_visible(False)


def _goes_round(angle: Array) -> bool:
    """Whether the readings go all the way round."""
    again = np.min(angle) + 2.0 * math.pi
    steps = np.diff([*np.sort(angle), again])
    return bool(steps.max() < 4.0 * np.median(steps) + 1e-9)


def _ruler(axes: Any, largest: float, unit: str) -> None:
    """A bar in the middle of the circle, and the residual that it stands for."""
    size = _round_size(largest)
    bar: Any = {"color": style.INK, "lw": 1.8, "solid_capstyle": "butt"}
    axes.plot([0.0, 0.0], [0.0, SWING * size / largest], **bar)
    letters: Any = {"ha": "center", "va": "center", "fontsize": 6.5}
    axes.text(math.pi * 0.75, 0.16, f"{text.trimmed(size, 2)} {unit}", **letters)


def _round_size(largest: float) -> float:
    """1, 2 or 5 times a power of ten, at most `largest`."""
    power = 10.0 ** math.floor(math.log10(largest))
    sizes = [k * power for k in (1.0, 2.0, 5.0)]
    return max(size for size in sizes if size <= largest * (1.0 + 1e-9))
