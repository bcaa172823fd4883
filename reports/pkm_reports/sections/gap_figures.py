"""Pictures of the gap: residuals along the runs that show it best, effects and their size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.result import GapSection, Trace
from pkm_reports import missing, style, text

# Residuals of each run, before and after the effects are in the model.

MAX_TRACES: Final = 9
MAX_COLUMNS: Final = 3
#: readings of a run up to which each has a mark of full size
FULL_SIZE_MAX_READINGS: Final = 60
QUANTILE = 0.98  #: quantile of the residuals that a figure shows
FAR = 3.0  #: factor above it that counts as an outlier
#: channels that set-ups have alone, so that a title need not name them
SINGLE_CHANNELS: Final = ("length", "height")
AXIS_LABELS: Final = {"circle": "angle [°]", "line": "distance along the line [mm]"}


def draw_traces(traces: Sequence[Trace]) -> style.Figure:
    """A panel for each run: residuals before, explained part, residuals after."""
    shown = choose_traces(traces)
    if not shown:
        return style.empty("No residuals are stored in this result.")
    columns = 2 if len(shown) == 4 else min(MAX_COLUMNS, len(shown))
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


def choose_traces(traces: Sequence[Trace]) -> list[Trace]:
    """Up to MOST runs with the largest residuals before, in the order of the data."""
    measured = [trace for trace in traces if missing.finite(trace.before)]
    sizes = [rms(missing.array(trace.before)) for trace in measured]
    ranked = sorted(range(len(measured)), key=lambda k: -sizes[k])
    return [measured[k] for k in sorted(ranked[:MAX_TRACES])]


def rms(values: Array) -> float:
    """Root mean square of the finite values; 0 where there is none."""
    if not np.isfinite(values).any():
        return 0.0
    return float(np.sqrt(np.nanmean(values**2)))


def largest_size(values: Sequence[float | None]) -> float:
    """Largest size of the finite values."""
    return max(map(abs, missing.finite(values)), default=0.0)


def trace_title(trace: Trace, *, loads: bool = False) -> str:
    """Set-up and run, with the channel and the payload (`loads`) where they matter."""
    name = f"{trace.setup}, {trace.run}"
    if trace.channel not in SINGLE_CHANNELS:
        name += f", {trace.channel}"
    if loads and trace.payload is not None:
        name += f", {text.trimmed(trace.payload, 4)} N"
    return name


def _limits(traces: Sequence[Trace]) -> dict[str, float]:
    """Half of the vertical range for each unit, the same in all panels, outliers aside."""
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


def _panel(axes: style.Axes, trace: Trace, limit: float) -> None:
    along = missing.array(trace.at)
    explained = missing.array(trace.explained)
    unexplained = missing.array(trace.unexplained)
    marks: Any = {
        "ls": "",
        "marker": "o",
        "ms": 2.6 if len(along) <= FULL_SIZE_MAX_READINGS else 1.5,
    }
    joined = trace.kind != "points"
    lines: Any = {"ls": "-" if joined else "", "marker": "" if joined else "_", "ms": 5}

    def plot(values: Array, label: str, **look: Any) -> None:
        axes.plot(along, np.clip(values, -limit, limit), label=label, **look)

    axes.axhline(0.0, color=style.INK, lw=0.6)
    plot(missing.array(trace.before), "before", color=style.GREY, **marks)
    if np.any(explained):
        label = "explained by the effects"
        plot(explained, label, lw=1.2, color=style.ORANGE, **lines)
    if np.any(unexplained):
        plot(unexplained, "unknown form", color=style.PINK, **lines)
    if np.any(explained):
        plot(missing.array(trace.after), "after", color=style.BLUE, **marks)
    axes.set_ylim(-limit, limit)
    style.few_ticks(axes.yaxis, 4)
    if trace.kind == "circle":
        axes.set_xlim(0.0, 360.0)
        style.ticks_every(axes.xaxis, 90.0)
    else:
        style.few_ticks(axes.xaxis, 4)


def _set_title(axes: style.Axes, trace: Trace, *, loads: bool) -> None:
    """Name of the run, and its rms before and after."""
    size = text.number(rms(missing.array(trace.before)), 2)
    if any(trace.explained):
        size += f" to {text.number(rms(missing.array(trace.after)), 2)}"
    name = style.label(trace_title(trace, loads=loads), 36)
    unit = text.unit_symbol(trace.unit)
    letters: Any = {"fontsize": 7, "fontweight": "normal"}
    axes.set_title(f"{name}\nrms {size} {unit}", **letters)


# Probability of each effect, and the size of those that were identified.

MAX_EFFECTS: Final = 10
#: probability above which only "more than" is written, never certainty
NEARLY_CERTAIN: Final = 0.99


def draw_effects(gap: GapSection) -> style.Figure:
    """Probabilities as bars, the likeliest first; beside them the sizes in the readings."""
    names = shown_effects(gap)
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


def shown_effects(gap: GapSection) -> list[str]:
    """Effects of the figure, the likeliest first, rivals of the best answer among them."""
    ranked = sorted(gap.marginal, key=lambda name: (-gap.marginal[name], name))
    late_rivals = _indistinguishable(gap) & set(ranked[MAX_EFFECTS:])
    first = ranked[: max(MAX_EFFECTS - len(late_rivals), MAX_EFFECTS // 2)]
    chosen = late_rivals.union(first)
    return [name for name in ranked if name in chosen][: 2 * MAX_EFFECTS]


def _indistinguishable(gap: GapSection) -> set[str]:
    """Effects that the readings cannot tell from those of the best answer."""
    best = gap.answers[:1]
    aliases = {name for answer in best for group in answer.classes for name in group}
    return aliases - set(gap.selected)


def spoken(name: str) -> str:
    """An effect's name as a person says it."""
    return "unknown form" if name == "unknown" else name.replace("_", " ")


def _draw_probabilities(
    axes: style.Axes, names: Sequence[str], gap: GapSection
) -> None:
    rivals = _indistinguishable(gap)
    percent = np.array([100.0 * gap.marginal[name] for name in names])
    rows = np.arange(float(len(names)))
    colours = [_colour(name, gap.selected, rivals) for name in names]
    axes.barh(rows, percent, color=colours, height=0.7)
    for y, name in zip(rows, names, strict=True):
        share = gap.marginal[name]
        axes.text(100.0 * share + 1.5, y, chance_text(share), va="center", fontsize=7)
    style.fixed_ticks(axes, "y", rows.tolist(), [spoken(name) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0.0, 115.0)
    ticks = [0.0, 25.0, 50.0, 75.0, 100.0]
    style.fixed_ticks(axes, "x", ticks, [f"{tick:.0f}" for tick in ticks])
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("probability that it acts [%]")


def _colour(name: str, selected: Sequence[str], rivals: set[str]) -> str:
    if name in selected:
        return style.BLUE
    return style.SKY if name in rivals else style.LIGHT


def chance_text(share: float) -> str:
    """A probability in percent, never rounded up to certainty."""
    if share > NEARLY_CERTAIN:
        return f"> {text.percent(NEARLY_CERTAIN)}"
    return text.percent(share)


def _draw_sizes(axes: style.Axes, rms: Array, unit: str) -> None:
    """Rms of each effect in the readings, over its channels."""
    rows = np.arange(float(len(rms)))
    axes.barh(rows, np.nan_to_num(rms), color=style.ORANGE, height=0.7)
    largest = float(np.nanmax(rms, initial=0.0)) or 1.0
    for y, size in zip(rows, rms, strict=True):
        if np.isfinite(size):
            label_at = size + 0.02 * largest
            axes.text(label_at, y, text.number(size), va="center", fontsize=7)
    axes.set_xlim(0.0, 1.2 * largest)
    style.few_ticks(axes.xaxis, 4)
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"size in the readings, rms [{unit}]")


def _rms(by_channel: Mapping[str, float]) -> float:
    """Rms over the channels in which the effect shows; NaN where it shows in none."""
    sizes = np.array([size for size in by_channel.values() if size > 0.0])
    return float(np.sqrt(np.mean(sizes**2))) if sizes.size else float("nan")


# Sizes in words.

#: rms, in the unit of its channel, from which an effect shows in a channel
MIN_VISIBLE_RMS: Final = 1e-9


def size_in_readings(gap: GapSection, sizes: Mapping[str, float]) -> str:
    """Rms by channel; the channel of readings that have one alone needs no name."""
    return sizes_by_channel(sizes, gap.units, named=len(gap.units) != 1)


def sizes_by_channel(
    sizes: Mapping[str, float | None], units: Mapping[str, str], *, named: bool
) -> str:
    """Rms by channel that is to be seen, with the channel's name or without."""
    entries = []
    for channel, rms in sizes.items():
        if rms is None or rms > MIN_VISIBLE_RMS:
            entry = text.channel_value(channel, rms, units)
            entries.append(f"{channel} {entry}" if named else entry)
    return text.listing(entries)
