"""Plans for several criteria: what the plan for one is worth by the others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.design import CRITERIA
from oed.result import CriterionComparison, DesignSection
from pkm_reports import missing, style, text
from pkm_reports.blocks import Block, Paragraph, Picture, Table, TableColumn
from pkm_reports.missing import or_nan


def criterion_value(criterion: str, value: float | None) -> str:
    """A value of a criterion: logarithms with two decimals."""
    entry = CRITERIA.entry(criterion)
    if entry is not None and entry.is_log_det:
        return text.fixed(value, 2)
    return text.number(value, 4)


# Efficiency of the design for each criterion by all others, as a shaded table.

#: share of the colour scale above which letters are white
WHITE_LETTER_MIN_SHADE: Final = 0.55
#: least |log ratio| from which a number of directions is computed
MIN_LOG: Final = 1e-4


def draw_efficiencies(design: DesignSection) -> style.Figure:
    """A row for each criterion, a column for the design made for it."""
    table = efficiencies(design.compared, design.directions)
    if not np.isfinite(table).any():
        return style.empty("No designs for further criteria are stored in this result.")
    names = [entry.name for entry in design.compared]
    width = min(style.FIGURE_WIDTH, 2.6 + 0.62 * len(names))
    figure = style.figure(0.75 + 0.3 * len(names), width)
    axes = figure.subplots()
    low = min(0.5, math.floor(10.0 * float(np.nanmin(table))) / 10.0)
    shade: Any = {"cmap": style.AMOUNT, "vmin": low, "vmax": 1.0, "aspect": "auto"}
    image = axes.imshow(np.ma.masked_invalid(np.minimum(table, 1.0)), **shade)
    _write_percentages(axes, table, low)
    style.fixed_ticks(axes, "x", range(len(names)), names)
    style.fixed_ticks(axes, "y", range(len(names)), names)
    axes.grid(False)
    axes.set(xlabel="plan designed for …", ylabel="… judged by")
    bar: Any = figure.colorbar(image, ax=axes, label="efficiency", pad=0.02)
    bar.outline.set_visible(False)
    return figure


def efficiencies(compared: Sequence[CriterionComparison], directions: int = 0) -> Array:
    """phi by criterion i of design j over phi of the design for i (criteria, designs).

    Plans are taken to have the same number of readings. NaN where a plan leaves a
    direction unseen, or where the stored numbers do not give phi.
    """
    names = [entry.name for entry in compared]
    table = np.full((len(names), len(names)), np.nan)
    for i, entry in enumerate(compared):
        values = {name: missing.entry(entry.values, name) for name in names}
        size = _counted_directions(entry, values, names[0], directions)
        for j, name in enumerate(names):
            table[i, j] = _ratio(entry.name, values[name], values[entry.name], size)
        table[i, i] = 1.0
    return table


def _ratio(criterion: str, value: float, best: float, directions: float) -> float:
    """phi of a design over phi of the best one; NaN for a criterion of another version."""
    entry = CRITERIA.entry(criterion)
    return math.nan if entry is None else entry.phi_ratio(value, best, directions)


def _counted_directions(
    entry: CriterionComparison, values: Mapping[str, float], main: str, directions: int
) -> float:
    """What log det is divided by: the number of directions that count.

    It follows from the bound or the gain, where these differ from the value itself.
    """
    catalogue_entry = CRITERIA.entry(entry.name)
    if (
        catalogue_entry is None or catalogue_entry.form is None
    ):  # a weighted mean of log phi
        return 1.0
    below_bound = entry.value - or_nan(entry.bound)
    above_main = values[entry.name] - values[main]
    sizes = [
        _directions_from(below_bound, or_nan(entry.efficiency)),
        _directions_from(above_main, or_nan(entry.gain)),
    ]
    for size in sizes:
        if math.isfinite(size) and size > 0.0:
            return size
    judges_all = catalogue_entry.needs == "none"
    return float(directions) if judges_all and directions > 0 else math.nan


def _directions_from(difference: float, ratio: float) -> float:
    """Directions for which a difference of log det is a ratio of phi; NaN if unclear."""
    if not ratio > 0.0 or abs(math.log(ratio)) <= MIN_LOG:
        return math.nan
    return difference / math.log(ratio)


def _write_percentages(axes: style.Axes, table: Array, low: float) -> None:
    for (i, j), share in np.ndenumerate(table):
        dark = (share - low) / (1.0 - low) > WHITE_LETTER_MIN_SHADE
        ink = style.INK if np.isfinite(share) else style.GREY
        letters: Any = {"ha": "center", "va": "center", "fontsize": 7.5}
        letters["color"] = "white" if dark else ink
        letters["fontweight"] = "bold" if i == j else "normal"
        axes.text(j, i, text.percent(share), **letters)


#: criteria from which the values by the others have a table of their own
MANY_CRITERIA: Final = 4


def criteria_blocks(design: DesignSection) -> list[Block]:
    """Figure of efficiencies, and the values behind it."""
    compared = design.compared
    if not compared:
        return []
    names = [entry.name for entry in compared]
    content: list[Block] = [
        Paragraph(_criteria_introduction(names)),
        Picture(
            "compared", lambda: draw_efficiencies(design), _criteria_caption(design)
        ),
    ]
    if len(names) <= MANY_CRITERIA:
        return [*content, _one_table(compared, names)]
    rows = [_certificate_row(entry) for entry in compared]
    return [
        *content,
        Table(_certificate_columns(names), rows, _certificates_text(names)),
        _values(compared, names),
    ]


def _criteria_introduction(names: Sequence[str]) -> str:
    criteria_count = "1 criterion" if len(names) == 1 else f"{len(names)} criteria"
    return (
        f"Under the same rules the study designs a plan for each of {criteria_count},"
        f" {text.listing(names)}, and judges it by all of them. The plan of this study"
        f" is the one for {names[0]}."
    )


def _criteria_caption(design: DesignSection) -> str:
    """The worst plan by another criterion, and the best compromise."""
    caption = (
        "Efficiency by each criterion (row) of the plan for each criterion (column),"
        " relative to the plan for the row's criterion."
    )
    names = [entry.name for entry in design.compared]
    table = efficiencies(design.compared, design.directions)
    diagonal = np.eye(len(names), dtype=bool)
    others = np.where(diagonal, np.nan, table)
    if not np.isfinite(others).any():
        return caption
    i, j = np.unravel_index(int(np.nanargmin(others)), others.shape)
    worst = text.percent(others[i, j])
    least = np.nanmin(np.where(np.isfinite(table), table, np.inf), axis=0)
    best = int(np.argmax(least))
    return (
        f"{caption} The lowest: the plan for {names[j]} reaches {worst} by {names[i]}."
        f" The best compromise is the plan for {names[best]}, with"
        f" {text.percent(least[best])} or more by all."
    )


def _one_table(compared: Sequence[CriterionComparison], names: Sequence[str]) -> Table:
    """Certificates and the values of all plans side by side."""
    columns = [*_certificate_columns(names), *_plan_columns(names)]
    rows = [[*_certificate_row(entry), *_value_row(entry, names)] for entry in compared]
    caption = f"{_certificates_text(names)} Then its value for each of the plans."
    return Table(columns, rows, caption)


def _values(compared: Sequence[CriterionComparison], names: Sequence[str]) -> Table:
    columns = [TableColumn("By"), *_plan_columns(names)]
    rows = [[entry.name, *_value_row(entry, names)] for entry in compared]
    better = "Larger is better"
    if "kappa" in names:
        better += "; for kappa, smaller"
    caption = (
        "Values by each criterion (row) of the plan for each criterion (column)."
        f" {better}."
    )
    return Table(columns, rows, caption)


def _certificates_text(names: Sequence[str]) -> str:
    return (
        "One row a criterion: the value of the plan for it, the bound that no plan"
        " passes, the certified share of the best possible, and the gain over the plan"
        f" for {names[0]}."
    )


def _certificate_columns(names: Sequence[str]) -> list[TableColumn]:
    titles = ("Value", "Bound", "Certified", f"Gain over {names[0]}")
    return [TableColumn("Criterion"), *TableColumn.numbers(*titles)]


def _plan_columns(names: Sequence[str]) -> list[TableColumn]:
    return TableColumn.numbers(*[f"plan for {name}" for name in names])


def _certificate_row(entry: CriterionComparison) -> list[str]:
    share = text.percent_at_least(entry.efficiency)
    return [
        entry.name,
        criterion_value(entry.name, entry.value),
        text.MISSING
        if entry.bound is None
        else criterion_value(entry.name, entry.bound),
        "proven" if entry.proven else share,
        text.times(entry.gain),
    ]


def _value_row(entry: CriterionComparison, names: Sequence[str]) -> list[str]:
    return [
        criterion_value(entry.name, missing.entry(entry.values, name)) for name in names
    ]
