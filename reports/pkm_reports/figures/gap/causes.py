"""Which effects act, and how large they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pkm_reports import style, words

MOST: Final = 10


def draw(gap: Mapping[str, Any]) -> Figure:
    """Probability of each effect as a bar, the likeliest first; beside it the size of
    those that were found.
    """
    names = shown(gap)
    if not names:
        return style.empty("No effect could be tested with these readings.")
    sizes = {str(s["effect"]): s.get("rms") or {} for s in gap.get("sizes") or []}
    figure = style.figure(0.75 + 0.24 * len(names))
    sized = (
        any(sizes.get(n) for n in names)
        and len(set((gap.get("units") or {}).values())) == 1
    )
    grid = (
        figure.subplots(1, 2, squeeze=False, sharey=True, width_ratios=(3, 2))[0]
        if sized
        else [figure.subplots()]
    )
    rivals = _rivals(gap)
    colours = [
        (
            style.BLUE
            if n in gap["selected"]
            else style.SKY
            if n in rivals
            else style.LIGHT
        )
        for n in names
    ]
    _probabilities(grid[0], names, gap["marginal"], colours)
    if sized:
        _sizes(grid[1], names, sizes, words.unit(next(iter(gap["units"].values()))))
    return figure


def shown(gap: Mapping[str, Any]) -> list[str]:
    """Effects shown, the likeliest first; what cannot be told from those found is
    always among them.
    """
    marginal = gap.get("marginal") or {}
    ranked = sorted(marginal, key=lambda n: (-words.number(marginal[n]), n))
    rivals = _rivals(gap) & set(ranked[MOST:])
    kept = set(ranked[: max(MOST - len(rivals), MOST // 2)]) | rivals
    return [n for n in ranked if n in kept][: 2 * MOST]


def _rivals(gap: Mapping[str, Any]) -> set[str]:
    """Effects that the readings cannot tell from those of the best answer."""
    best = (gap.get("answers") or [{}])[0]
    return {str(n) for c in best.get("classes") or [] for n in c} - set(
        gap.get("selected") or []
    )


def spoken(name: str) -> str:
    """An effect's name as a person says it."""
    return "unknown form" if name == "unknown" else str(name).replace("_", " ")


def _probabilities(
    axes: Axes, names: list[str], marginal: Mapping[str, Any], colours: list[str]
) -> None:
    values = np.array([100.0 * words.number(marginal[n]) for n in names])
    at = np.arange(float(len(names)))
    axes.barh(at, values, color=colours, height=0.7)
    for y, value, name in zip(at, values, names, strict=True):
        axes.text(value + 1.5, y, _chance(marginal[name]), va="center", fontsize=7)
    style.fixed_ticks(axes, "y", at.tolist(), [spoken(n) for n in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0.0, 115.0)
    style.fixed_ticks(
        axes, "x", [0.0, 25.0, 50.0, 75.0, 100.0], ["0", "25", "50", "75", "100"]
    )
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("probability that it acts [%]")


def _chance(share: Any) -> str:
    """A probability in percent, never rounded up to certainty."""
    return f"> 99{words.GAP}%" if words.number(share) > 0.99 else words.percent(share)


def _sizes(
    axes: Axes, names: list[str], sizes: Mapping[str, Mapping[str, Any]], unit: str
) -> None:
    """Rms of each effect in the readings, over its channels."""
    values = np.array([_rms(sizes.get(n) or {}) for n in names])
    at = np.arange(float(len(names)))
    axes.barh(at, np.nan_to_num(values), color=style.ORANGE, height=0.7)
    largest = float(np.nanmax(values, initial=0.0)) or 1.0
    for y, value in zip(at, values, strict=True):
        if np.isfinite(value):
            axes.text(
                value + 0.02 * largest, y, words.num(value), va="center", fontsize=7
            )
    axes.set_xlim(0.0, 1.2 * largest)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"size in the readings, rms [{unit}]")


def _rms(by_channel: Mapping[str, Any]) -> float:
    values = style.array([v for v in by_channel.values() if words.number(v) > 0.0])
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
