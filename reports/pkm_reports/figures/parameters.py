"""Identified parameters against their tolerance: where they lie, and how much the
readings tightened them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pkm_reports import style, words

COLOURS = {"seen": style.BLUE, "weak": style.ORANGE, "prior": style.GREY}
MEANING = {"seen": "seen", "weak": "weakly seen", "prior": "tolerance only"}


def draw(parameters: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Left: 95 % intervals in tolerances (prior standard deviations); right: sd after
    over tolerance.
    """
    rows = [
        (name, v)
        for name, v in parameters.items()
        if words.number(v.get("prior_sd")) > 0.0
    ]
    if not rows:
        return style.empty("No parameter with a tolerance is stored in this result.")
    figure = style.figure(0.9 + 0.155 * max(len(rows), 4))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for k, (_, value) in enumerate(rows):
        _interval(left, right, k, value)
    _dress(
        left,
        right,
        [name for name, _ in rows],
        [normalised(value)[1] for _, value in rows],
    )
    handles, labels = left.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(unique.values(), unique.keys(), loc="outside lower center", ncols=5)
    return figure


def normalised(value: Mapping[str, Any]) -> tuple[float, float, float]:
    """Deviation from nominal, its sd and the truth, all in prior standard deviations."""
    prior, nominal = words.number(value["prior_sd"]), words.number(value["nominal"])
    middle = (words.number(value["value"]) - nominal) / prior
    return (
        middle,
        words.number(value["sd"]) / prior,
        (words.number(value.get("truth")) - nominal) / prior,
    )


def _interval(left: Axes, right: Axes, k: int, value: Mapping[str, Any]) -> None:
    middle, sd, truth = normalised(value)
    kind = str(value.get("identified", "seen"))
    colour, label = COLOURS.get(kind, style.BLUE), MEANING.get(kind, kind)
    left.plot(
        [middle - 1.96 * sd, middle + 1.96 * sd],
        [k, k],
        color=colour,
        lw=2.2,
        solid_capstyle="butt",
    )
    left.plot(middle, k, "o", color=colour, ms=3.5, label=label)
    if np.isfinite(truth):
        left.plot(
            truth,
            k,
            "x",
            color=style.INK,
            ms=5,
            mew=1.1,
            label="truth (virtual machine)",
            zorder=4,
        )
    right.plot(sd, k, "o", color=colour, ms=4)


def _dress(left: Axes, right: Axes, names: list[str], sds: list[float]) -> None:
    left.axvspan(-1.0, 1.0, color="#eef1f4", lw=0, zorder=0, label="± 1 tolerance")
    left.set(xlabel="deviation from nominal [tolerances], 95 % interval")
    right.axvline(1.0, color=style.GREY, ls="--", lw=0.9)
    right.set_xlim(
        min([0.08, *[0.6 * sd for sd in sds if sd > 0.0]]), 1.6 * max([1.0, *sds])
    )
    style.log_axis(right, "x")
    right.set(xlabel="sd after / tolerance")
    style.fixed_ticks(left, "y", range(len(names)), names)
    left.set_ylim(len(names) - 0.4, -0.6)
    right.tick_params(axis="y", labelleft=False)
