"""Residual accuracy of each pose component, before and after, on a log scale, lengths
and angles apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pkm_reports import style, words

Parts = Mapping[str, Mapping[str, Any]]
Bars = Sequence[tuple[str, str, str]]
BARS: Final = (
    ("before", "before", style.LIGHT),
    ("after", "after correction by the controller", style.BLUE),
    ("known", "if further axes corrected it too", style.GREEN),
)
REALISED: Final = "realised, virtual machine"


def draw(prediction: Mapping[str, Any]) -> Figure:
    """Bars of rms over the workspace; diamonds where a virtual machine showed what came
    true.
    """
    parts: Parts = prediction.get("components") or {}
    if not parts:
        return style.empty("No predicted accuracy is stored in this result.")
    units = list(dict.fromkeys(part["after"]["unit"] for part in parts.values()))
    groups = [
        {n: p for n, p in parts.items() if p["after"]["unit"] == unit} for unit in units
    ]
    bars = BARS[:2] if same(parts) else BARS
    figure = style.figure(2.8)
    panels = figure.subplots(
        1, len(units), squeeze=False, width_ratios=[len(g) for g in groups]
    )[0]
    for axes, unit, group in zip(panels, units, groups, strict=True):
        _panel(axes, group, bars, prediction.get("realised") or {})
        axes.set_ylabel(f"rms error [{words.unit(unit)}]")
    named = dict(zip(*panels[0].get_legend_handles_labels()[::-1], strict=True))
    labels = [label for _, label, _ in bars] + [
        label for label in named if label == REALISED
    ]
    figure.legend(
        [named[label] for label in labels],
        labels,
        loc="outside lower center",
        ncols=len(labels),
    )
    return figure


def same(parts: Parts) -> bool:
    """Whether `known` tells nothing beyond `after`: the controller corrects all
    components.
    """
    return all(part["known"]["rms"] == part["after"]["rms"] for part in parts.values())


def _panel(axes: Axes, group: Parts, bars: Bars, realised: Mapping[str, Any]) -> None:
    at = np.arange(len(group))
    for k, (key, label, colour) in enumerate(bars):
        heights = [words.number(part[key]["rms"]) for part in group.values()]
        axes.bar(
            at + 0.27 * (k - (len(bars) - 1) / 2.0),
            np.where(np.array(heights) > 0, heights, np.nan),
            0.25,
            color=colour,
            label=label,
        )
    true = np.array(
        [words.number((realised.get(name) or {}).get("rms")) for name in group]
    )
    if np.isfinite(true).any():
        axes.plot(
            at,
            true,
            "D",
            color=style.ORANGE,
            mec=style.INK,
            mew=0.6,
            ms=5,
            label=REALISED,
        )
    style.log_axis(axes, "y")
    _room(axes, group, true)
    labels = [
        name if part["compensatable"] else f"{name} *" for name, part in group.items()
    ]
    style.fixed_ticks(axes, "x", at.tolist(), labels)
    axes.grid(False, axis="x")


def _room(axes: Axes, group: Parts, true: Any) -> None:
    """Limits from a third of the smallest to twice the largest, so that no bar
    vanishes.
    """
    values = [
        words.number(part[key]["rms"]) for part in group.values() for key, _, _ in BARS
    ]
    values = [v for v in [*values, *true] if np.isfinite(v) and v > 0]
    if values:
        axes.set_ylim(min(values) / 3.0, 2.0 * max(values))
        style.log_axis(axes, "y")
