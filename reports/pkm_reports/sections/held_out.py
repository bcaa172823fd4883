"""Chapter: readings held out of the fit, and how well the fit predicts them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.result import HeldOutSection, StudyResult
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Picture,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)

# Residuals of held-out readings, with their predictive intervals.


def draw_residuals(sets: Sequence[HeldOutSection]) -> Figure:
    """Measured minus predicted, each with its 95 % interval as a bar around zero."""
    shown = [entry for entry in sets if entry.residuals]
    if not shown:
        return style.empty("No held-out residuals are stored in this result.")
    figure = style.figure(0.5 + 1.75 * len(shown))
    panels = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
    for axes, entry in zip(panels, shown, strict=True):
        _panel(axes, entry)
    style.legend_below(figure, style.legend_entries(figure.axes[:1]), 3)
    return figure


def _panel(axes: Axes, entry: HeldOutSection) -> None:
    residuals = missing.array(entry.residuals)
    half = np.resize(missing.array(entry.half_widths or [None]), len(residuals))
    number = np.arange(1, len(residuals) + 1)
    inside = ~(np.abs(residuals) > half)
    bars: Any = {"color": style.LIGHT, "lw": min(7.0, 200.0 / len(number))}
    axes.vlines(number, -half, half, label="95 % predictive interval", **bars)
    axes.plot(
        number[inside],
        residuals[inside],
        "o",
        color=style.BLUE,
        label="inside",
    )
    cross: Any = {"color": style.RED, "ms": 5, "label": "outside"}
    axes.plot(number[~inside], residuals[~inside], "X", **cross)
    axes.axhline(0.0, color=style.INK, lw=0.7)
    axes.xaxis.set_major_locator(MaxNLocator(12, integer=True))
    axes.set_title(style.label(f"{entry.name}: {entry.channel}", 70))
    unit = text.unit_symbol(entry.unit)
    axes.set(xlabel="reading", ylabel=f"residual [{unit}]")


LEAST_COVERAGE: Final = 0.85
CAPTION: Final = (
    "Prediction of held-out readings. A new set-up has unknowns of its own (an offset, a"
    " scale). The first rms adjusts them to its readings; the second leaves them at"
    " their nominal values."
)


def blocks(result: StudyResult) -> list[Block]:
    """Residuals with predictive intervals, and a table of rms and coverage."""
    sets = result.held_out
    if not sets:
        return []
    picture = Picture("held_out", lambda: draw_residuals(sets), _caption(sets))
    return [picture, _table(sets)]


def _caption(sets: Sequence[HeldOutSection]) -> str:
    inside = [
        f"{text.percent(entry.coverage)} of {entry.n} in {_name(entry)}"
        for entry in sets
    ]
    caption = (
        "Measured minus predicted, for readings that the fit did not use. Inside their"
        f" 95 % interval: {text.listing(inside)}."
    )
    narrow = [_name(entry) for entry in sets if not _is_covered(entry)]
    if narrow:
        return (
            f"{caption} That is too few in {text.listing(narrow)}: the stated"
            " uncertainty is too small there."
        )
    return f"{caption} That agrees with the stated uncertainty."


def _name(entry: HeldOutSection) -> str:
    return f"{entry.name} ({entry.channel})"


def _is_covered(entry: HeldOutSection) -> bool:
    return entry.coverage >= LEAST_COVERAGE


def _table(sets: Sequence[HeldOutSection]) -> Table:
    columns = [
        wide_column("Readings"),
        TableColumn("Channel"),
        *number_columns("Number", "Rms", "Rms, unadjusted", "Inside 95 % interval"),
    ]
    rows = [
        [
            entry.name,
            entry.channel,
            str(entry.n),
            text.quantity(entry.rms, entry.unit),
            text.quantity(entry.rms_raw, entry.unit),
            text.percent(entry.coverage),
        ]
        for entry in sets
    ]
    marks = ["good" if _is_covered(entry) else "bad" for entry in sets]
    return Table(columns, rows, CAPTION, marks)


CHAPTER: Final = Chapter("held-out", "Held-out prediction", blocks)
