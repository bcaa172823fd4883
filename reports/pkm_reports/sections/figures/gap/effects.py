"""Probability of each effect, and the size of those that were identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.base import Array
from oed.result import GapSection
from pkm_reports import missing, style, text

MOST: Final = 10
#: probability above which only "more than" is written, never certainty
NEARLY_CERTAIN: Final = 0.99


def draw(gap: GapSection) -> Figure:
    """Probabilities as bars, the likeliest first; beside them the sizes in the readings."""
    names = shown(gap)
    if not names:
        return style.empty("No effect could be tested with these readings.")
    sizes = {record.effect: _rms(record.rms) for record in gap.sizes}
    figure = style.figure(0.75 + 0.24 * len(names))
    one_unit = len(set(gap.units.values())) == 1
    rms = np.array([missing.entry(sizes, name) for name in names])
    if not one_unit or not np.isfinite(rms).any():
        _draw_probabilities(figure.subplots(), names, gap)
        return figure
    shared: Any = {"sharey": True, "width_ratios": (3, 2)}
    chances, sizes_panel = figure.subplots(1, 2, **shared)
    _draw_probabilities(chances, names, gap)
    unit = next(iter(gap.units.values()))
    _draw_sizes(sizes_panel, rms, text.unit_symbol(unit))
    return figure


def shown(gap: GapSection) -> list[str]:
    """Effects that the figure shows, the likeliest first.

    Effects that the readings cannot tell from the best answer are always among them.
    """
    ranked = sorted(gap.marginal, key=lambda name: (-gap.marginal[name], name))
    late_rivals = _indistinguishable(gap) & set(ranked[MOST:])
    first = ranked[: max(MOST - len(late_rivals), MOST // 2)]
    chosen = late_rivals.union(first)
    return [name for name in ranked if name in chosen][: 2 * MOST]


def _indistinguishable(gap: GapSection) -> set[str]:
    """Effects that the readings cannot tell from those of the best answer."""
    best = gap.answers[:1]
    aliases = {name for answer in best for group in answer.classes for name in group}
    return aliases - set(gap.selected)


def spoken(name: str) -> str:
    """An effect's name as a person says it."""
    return "unknown form" if name == "unknown" else name.replace("_", " ")


def _draw_probabilities(
    axes: Axes,
    names: Sequence[str],
    gap: GapSection,
) -> None:
    rivals = _indistinguishable(gap)
    percent = np.array([100.0 * gap.marginal[name] for name in names])
    rows = np.arange(float(len(names)))
    colours = [_colour(name, gap.selected, rivals) for name in names]
    axes.barh(rows, percent, color=colours, height=0.7)
    for y, name in zip(rows, names, strict=True):
        share = gap.marginal[name]
        axes.text(
            100.0 * share + 1.5,
            y,
            _chance(share),
            va="center",
            fontsize=7,
        )
    style.fixed_ticks(axes, "y", rows.tolist(), [spoken(name) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0.0, 115.0)
    ticks = [0.0, 25.0, 50.0, 75.0, 100.0]
    style.fixed_ticks(axes, "x", ticks, [f"{tick:.0f}" for tick in ticks])
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("probability that it acts [%]")


def _colour(
    name: str,
    selected: Sequence[str],
    rivals: set[str],
) -> str:
    if name in selected:
        return style.BLUE
    return style.SKY if name in rivals else style.LIGHT


def _chance(share: float) -> str:
    """A probability in percent, never rounded up to certainty."""
    if share > NEARLY_CERTAIN:
        return f"> 99{text.NO_BREAK}%"
    return text.percent(share)


def _draw_sizes(axes: Axes, rms: Array, unit: str) -> None:
    """Rms of each effect in the readings, over its channels."""
    rows = np.arange(float(len(rms)))
    axes.barh(
        rows,
        np.nan_to_num(rms),
        color=style.ORANGE,
        height=0.7,
    )
    largest = float(np.nanmax(rms, initial=0.0)) or 1.0
    for y, size in zip(rows, rms, strict=True):
        if np.isfinite(size):
            label_at = size + 0.02 * largest
            axes.text(
                label_at,
                y,
                text.number(size),
                va="center",
                fontsize=7,
            )
    axes.set_xlim(0.0, 1.2 * largest)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"size in the readings, rms [{unit}]")


def _rms(by_channel: Mapping[str, float]) -> float:
    """Rms over the channels in which the effect shows; NaN where it shows in none."""
    sizes = np.array([size for size in by_channel.values() if size > 0.0])
    return float(np.sqrt(np.mean(sizes**2))) if sizes.size else float("nan")
