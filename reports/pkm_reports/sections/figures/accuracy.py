"""Residual accuracy of each pose component before and after calibration, as bars.

Lengths and angles have panels of their own, each on a log scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import ComponentAccuracy, PredictionSection, SpreadRecord
from pkm_reports import style, text

Components = Mapping[str, ComponentAccuracy]
State = Literal["before", "after", "known"]
#: what each bar of a component shows: attribute, label, colour
Bar = tuple[State, str, str]
BARS: Final[tuple[Bar, ...]] = (
    ("before", "before", style.LIGHT),
    ("after", "after correction by the controller", style.BLUE),
    ("known", "with additional axes", style.GREEN),
)
REALISED: Final = "realised, virtual machine"
#: width of a bar, and distance between the bars of a component
BAR_WIDTH, BAR_STEP = 0.25, 0.27


def draw(prediction: PredictionSection) -> Figure:
    """Bars of the rms over the workspace, with a diamond for the virtual machine."""
    components = prediction.components
    if not components:
        return style.empty("No predicted accuracy is stored in this result.")
    units = list(dict.fromkeys(c.after.unit for c in components.values()))
    groups = [
        {name: c for name, c in components.items() if c.after.unit == unit}
        for unit in units
    ]
    bars = BARS[:2] if all_correctable(components) else BARS
    figure = style.figure(2.8)
    widths = [len(group) for group in groups]
    grid = figure.subplots(
        1,
        len(units),
        squeeze=False,
        width_ratios=widths,
    )
    for axes, unit, group in zip(grid[0], units, groups, strict=True):
        _panel(axes, group, bars, prediction.realised or {})
        axes.set_ylabel(f"rms error [{text.unit_symbol(unit)}]")
    entries = style.legend_entries(grid[0][:1])
    labels = [label for _, label, _ in bars] + [REALISED]
    ordered = {label: entries[label] for label in labels if label in entries}
    style.legend_below(figure, ordered, len(ordered))
    return figure


def all_correctable(components: Components) -> bool:
    """Whether the controller corrects all components, so that `known` adds nothing."""
    return all(c.known.rms == c.after.rms for c in components.values())


def _panel(
    axes: Axes,
    group: Components,
    bars: Sequence[Bar],
    realised: Mapping[str, SpreadRecord],
) -> None:
    places = np.arange(len(group))
    for k, (state, label, colour) in enumerate(bars):
        sizes = [spread(component, state).rms for component in group.values()]
        heights = np.array(sizes)
        shift = BAR_STEP * (k - (len(bars) - 1) / 2.0)
        positive = np.where(heights > 0.0, heights, np.nan)
        axes.bar(places + shift, positive, BAR_WIDTH, color=colour, label=label)
    shown = np.array(
        [realised[name].rms if name in realised else np.nan for name in group]
    )
    if np.isfinite(shown).any():
        axes.plot(places, shown, "D", label=REALISED, **style.DIAMOND)
    style.log_axis(axes, "y")
    _set_limits(axes, group, shown)
    labels = [name if c.compensatable else f"{name} *" for name, c in group.items()]
    style.fixed_ticks(axes, "x", places.tolist(), labels)
    axes.grid(False, axis="x")


def spread(component: ComponentAccuracy, state: State) -> SpreadRecord:
    """Errors of a component in one state."""
    spreads = {
        "before": component.before,
        "after": component.after,
        "known": component.known,
    }
    return spreads[state]


def _set_limits(axes: Axes, group: Components, realised: Array) -> None:
    """From a third of the smallest to twice the largest, so that no bar vanishes."""
    states = [state for state, _, _ in BARS]
    heights = [
        spread(component, state).rms for component in group.values() for state in states
    ]
    sizes = np.array([*heights, *realised])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if sizes.size:
        axes.set_ylim(sizes.min() / 3.0, 2.0 * sizes.max())
        style.log_axis(axes, "y")
