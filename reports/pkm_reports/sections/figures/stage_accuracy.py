"""Accuracy of each pose component after each stage of a plan, on a log scale."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.base import Array
from oed.result import PlanSection, StageRecord
from pkm_reports import missing, style, text

REALISED: Final = "realised, virtual machines"
WANTED: Final = "wanted"
MOST_TICKS: Final = 12
#: shift of the diamonds, so that the line's own marks do not hide them
BESIDE: Final = 0.09


def draw(plan: PlanSection) -> Figure:
    """A line for each component; lengths and angles have panels of their own."""
    keys = components(plan)
    if not keys:
        return style.empty("No accuracy after the stages is stored in this result.")
    units = list(dict.fromkeys(text.split_unit(key)[1] for key in keys))
    figure = style.figure(2.9)
    panels = figure.subplots(1, len(units), squeeze=False)[0]
    for axes, unit in zip(panels, units, strict=True):
        for k, key in enumerate(keys):
            if text.split_unit(key)[1] == unit:
                colour = style.CYCLE[k % len(style.CYCLE)]
                _component(axes, key, plan, colour, style.marker(k))
        of_unit = f" [{text.unit_symbol(unit)}]" if unit else ""
        axes.set(xlabel="after stage", ylabel=f"rms error{of_unit}")
        _set_ticks(axes, len(plan.stages))
        style.log_axis(axes, "y")
    entries = style.legend_entries(panels)
    for label in (WANTED, REALISED):  # the last entries of the legend
        if label in entries:
            entries[label] = entries.pop(label)
    style.legend_below(figure, entries)
    return figure


def components(plan: PlanSection) -> list[str]:
    """Names with units (`z_um`) of components with at least one positive accuracy."""
    tables = [plan.start_accuracy, *[stage.accuracy for stage in plan.stages]]
    positive = [key for table in tables for key, rms in table.items() if rms > 0.0]
    return list(dict.fromkeys(positive))


def realised(stage: StageRecord) -> dict[str, float]:
    """Accuracy that virtual machines reached: the prediction times their ratio to it."""
    ratios = {key: component_label(stage.realised, key) for key in stage.accuracy}
    reached = {key: ratios[key] * rms for key, rms in stage.accuracy.items()}
    return {key: rms for key, rms in reached.items() if math.isfinite(rms)}


def component_label(table: Mapping[str, float], key: str) -> float:
    """The number of a component, stored with its unit in the name or without."""
    return missing.entry(table, key if key in table else stem(key))


def stem(key: str) -> str:
    """The component's name without its unit: z_um -> z."""
    return key.rpartition("_")[0] if text.split_unit(key)[1] else key


def _component(
    axes: Axes, key: str, plan: PlanSection, colour: str, marker: str
) -> None:
    at = np.arange(len(plan.stages) + 1)
    tables = [plan.start_accuracy, *[stage.accuracy for stage in plan.stages]]
    predicted = _positive(missing.column(tables, key))
    label = style.label(text.split_unit(key)[0])
    axes.plot(at, predicted, color=colour, marker=marker, label=label)
    tables = [{}, *[realised(stage) for stage in plan.stages]]
    reached = _positive(missing.column(tables, key))
    if np.isfinite(reached).any():
        axes.plot(at + BESIDE, reached, "D", label=REALISED, **style.DIAMOND)
    wanted = missing.entry(plan.goal, key)
    if wanted > 0.0:
        axes.axhline(wanted, color=colour, ls=":", lw=1.0)
        axes.plot(
            [],
            [],
            color=style.GREY,
            ls=":",
            lw=1.0,
            label=WANTED,
        )


def _positive(values: Array) -> Array:
    """Numbers; NaN for what a log axis cannot show."""
    return np.where(values > 0.0, values, np.nan)


def _set_ticks(axes: Axes, count: int) -> None:
    """`before`, then the stages by number; of many stages, every other or so."""
    step = 1 + (count - 1) // MOST_TICKS
    places = [0, *range(step, count + 1, step)]
    style.fixed_ticks(axes, "x", places, ["before", *[str(k) for k in places[1:]]])
    axes.set_xlim(-0.25, count + 0.3)
