"""Identified parameters against their tolerances: value, interval, improvement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.result import ParameterEstimate
from pkm_reports import style, text
from pkm_reports.missing import or_nan

COLOURS: Final = {"seen": style.BLUE, "weak": style.ORANGE, "prior": style.GREY}
#: what `identified` of a parameter means
MEANING: Final = {
    "seen": "determined",
    "weak": "weakly determined",
    "prior": "tolerance only",
}
#: half-width of a 95 % interval, in standard deviations
HALF_WIDTH_95: Final = 1.96


def draw(parameters: Mapping[str, ParameterEstimate]) -> Figure:
    """95 % intervals in tolerances on the left, sd after over tolerance on the right."""
    rows = {name: p for name, p in parameters.items() if p.prior_sd > 0.0}
    if not rows:
        return style.empty("No parameter with a tolerance is stored in this result.")
    figure = style.figure(0.9 + 0.155 * max(len(rows), 4))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for k, estimate in enumerate(rows.values()):
        _interval(left, right, k, estimate)
    _set_axes(left, right, list(rows), [shrinkage(p) for p in rows.values()])
    style.legend_below(figure, style.legend_entries([left]), 5)
    return figure


def shrinkage(estimate: ParameterEstimate) -> float:
    """Standard deviation after the readings over that before them."""
    return estimate.sd / estimate.prior_sd if estimate.prior_sd > 0.0 else math.nan


def _interval(left: Axes, right: Axes, k: int, estimate: ParameterEstimate) -> None:
    deviation = (estimate.value - estimate.nominal) / estimate.prior_sd
    truth = (or_nan(estimate.truth) - estimate.nominal) / estimate.prior_sd
    sd, verdict = shrinkage(estimate), estimate.identified
    colour = COLOURS.get(verdict, style.BLUE)
    half = HALF_WIDTH_95 * sd
    bar: Any = {"color": colour, "lw": 2.2, "solid_capstyle": "butt"}
    left.plot([deviation - half, deviation + half], [k, k], **bar)
    label = text.meaning(verdict, MEANING)
    left.plot(deviation, k, "o", color=colour, ms=3.5, label=label)
    if math.isfinite(truth):
        cross: Any = {"color": style.INK, "ms": 5, "mew": 1.1, "zorder": 4}
        left.plot(truth, k, "x", label="truth (virtual machine)", **cross)
    right.plot(sd, k, "o", color=colour, ms=4)


def _set_axes(
    left: Axes, right: Axes, names: Sequence[str], shrinkages: Sequence[float]
) -> None:
    left.axvspan(-1.0, 1.0, color=style.SHADE, lw=0, zorder=0, label="± 1 tolerance")
    left.set(xlabel="deviation from nominal [tolerances], 95 % interval")
    right.axvline(1.0, color=style.GREY, ls="--", lw=0.9)
    smallest = min([0.08, *[0.6 * sd for sd in shrinkages if sd > 0.0]])
    right.set_xlim(smallest, 1.6 * max([1.0, *shrinkages]))
    style.log_axis(right, "x")
    right.set(xlabel="sd after / tolerance")
    style.fixed_ticks(left, "y", range(len(names)), names)
    left.set_ylim(len(names) - 0.4, -0.6)
    right.tick_params(axis="y", labelleft=False)
