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

COLOURS: Final = {
    "seen": style.BLUE,
    "weak": style.ORANGE,
    "prior": style.GREY,
}
#: what `identified` of a parameter means
MEANING: Final = {
    "seen": "determined",
    "weak": "weakly determined",
    "prior": "tolerance only",
}
#: half-width of a 95 % interval, in standard deviations
HALF_WIDTH_95: Final = 1.96


def draw(parameters: Mapping[str, ParameterEstimate]) -> Figure:
    """Intervals (95 %) in tolerances on the left, sd over tolerance on the right."""
    rows = {name: p for name, p in parameters.items() if p.prior_sd > 0.0}
    if not rows:
        return style.empty("No parameter with a tolerance is stored in this result.")
    figure = style.figure(0.9 + 0.155 * max(len(rows), 4))
    deviations, ratios = figure.subplots(
        1,
        2,
        sharey=True,
        width_ratios=(2, 1),
    )
    for k, estimate in enumerate(rows.values()):
        _interval(deviations, ratios, k, estimate)
    _set_axes(deviations, ratios, list(rows), [shrinkage(p) for p in rows.values()])
    style.legend_below(figure, style.legend_entries([deviations]), 5)
    return figure


def shrinkage(estimate: ParameterEstimate) -> float:
    """Standard deviation after the readings over that before them."""
    return estimate.sd / estimate.prior_sd if estimate.prior_sd > 0.0 else math.nan


def _interval(
    deviations: Axes,
    ratios: Axes,
    k: int,
    estimate: ParameterEstimate,
) -> None:
    deviation = (estimate.value - estimate.nominal) / estimate.prior_sd
    truth = (or_nan(estimate.truth) - estimate.nominal) / estimate.prior_sd
    sd, verdict = shrinkage(estimate), estimate.identified
    colour = COLOURS.get(verdict, style.BLUE)
    half = HALF_WIDTH_95 * sd
    bar: Any = {"color": colour, "lw": 2.2, "solid_capstyle": "butt"}
    deviations.plot([deviation - half, deviation + half], [k, k], **bar)
    label = text.meaning(verdict, MEANING)
    deviations.plot(
        deviation,
        k,
        "o",
        color=colour,
        ms=3.5,
        label=label,
    )
    if math.isfinite(truth):
        cross: Any = {
            "color": style.INK,
            "ms": 5,
            "mew": 1.1,
            "zorder": 4,
        }
        deviations.plot(truth, k, "x", label="truth (virtual machine)", **cross)
    ratios.plot(sd, k, "o", color=colour, ms=4)


def _set_axes(
    deviations: Axes, ratios: Axes, names: Sequence[str], shrinkages: Sequence[float]
) -> None:
    deviations.axvspan(
        -1.0,
        1.0,
        color=style.SHADE,
        lw=0,
        zorder=0,
        label="± 1 tolerance",
    )
    deviations.set(xlabel="deviation from nominal [tolerances], 95 % interval")
    ratios.axvline(1.0, color=style.GREY, ls="--", lw=0.9)
    smallest = min([0.08, *[0.6 * sd for sd in shrinkages if sd > 0.0]])
    ratios.set_xlim(smallest, 1.6 * max([1.0, *shrinkages]))
    style.log_axis(ratios, "x")
    ratios.set(xlabel="sd after / tolerance")
    style.fixed_ticks(deviations, "y", range(len(names)), names)
    deviations.set_ylim(len(names) - 0.4, -0.6)
    ratios.tick_params(axis="y", labelleft=False)
