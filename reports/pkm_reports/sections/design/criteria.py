"""Plans for several criteria: what the plan for one is worth by the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from oed.result import CriterionComparison, DesignSection
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_columns,
)
from pkm_reports.sections.design.certificate import criterion_value
from pkm_reports.sections.figures import criteria

#: criteria from which the values by the others have a table of their own
MANY: Final = 4


def blocks(design: DesignSection) -> list[Block]:
    """Figure of efficiencies, and the values behind it."""
    compared = design.compared
    if not compared:
        return []
    names = [entry.name for entry in compared]
    content: list[Block] = [
        Paragraph(_introduction(names)),
        Picture("compared", lambda: criteria.draw(design), _caption(design)),
    ]
    if len(names) <= MANY:
        return [*content, _one_table(compared, names)]
    return [*content, _certificates(compared, names), _values(compared, names)]


def _introduction(names: Sequence[str]) -> str:
    criteria_count = "1 criterion" if len(names) == 1 else f"{len(names)} criteria"
    return (
        f"Under the same rules the study designs a plan for each of {criteria_count},"
        f" {text.listing(names)}, and judges it by all of them. The plan of this study"
        f" is the one for {names[0]}."
    )


def _caption(design: DesignSection) -> str:
    """The worst plan by another criterion, and the best compromise."""
    caption = (
        "Efficiency by each criterion (row) of the plan for each criterion (column),"
        " relative to the plan for the row's criterion."
    )
    names = [entry.name for entry in design.compared]
    table = criteria.efficiencies(design.compared, design.directions)
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


# -- tables ----------------------------------------------------------------------------


def _one_table(compared: Sequence[CriterionComparison], names: Sequence[str]) -> Table:
    """Certificates and the values of all plans side by side."""
    columns = [*_certificate_columns(names), *_plan_columns(names)]
    rows = [[*_certificate_row(entry), *_value_row(entry, names)] for entry in compared]
    caption = f"{_certificates_text(names)} Then its value for each of the plans."
    return Table(columns, rows, caption)


def _certificates(
    compared: Sequence[CriterionComparison], names: Sequence[str]
) -> Table:
    rows = [_certificate_row(entry) for entry in compared]
    return Table(_certificate_columns(names), rows, _certificates_text(names))


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
    return [TableColumn("Criterion"), *number_columns(*titles)]


def _plan_columns(names: Sequence[str]) -> list[TableColumn]:
    return number_columns(*[f"plan for {name}" for name in names])


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
