"""Coefficients of the effects found, against the sizes expected of them."""

from __future__ import annotations

import math
from typing import Final

from oed.base import units
from oed.result import CoefficientRecord, GapSection
from pkm_reports.figures.gap.effects import spoken
from pkm_reports.page import text
from pkm_reports.page.blocks import (
    Block,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)

MOST: Final = 12


def blocks(gap: GapSection) -> list[Block]:
    """The largest coefficients in expected sizes, first the largest."""
    ranked = sorted(gap.coefficients, key=lambda c: -abs(in_expected_sizes(c, c.value)))
    shown = ranked[:MOST]
    if not shown:
        return []
    columns = [
        TableColumn("Effect"),
        wide_column("Coefficient"),
        *number_columns("Value", "Sd", "In expected sizes"),
    ]
    caption = (
        "Coefficients of the effects found, and in units of the size that was expected"
        " of each"
    )
    if len(ranked) > len(shown):
        caption += f"; the {len(shown)} largest of {len(ranked)}"
    return [Table(columns, [_row(c) for c in shown], f"{caption}.")]


def _row(coefficient: CoefficientRecord) -> list[str]:
    value = in_expected_sizes(coefficient, coefficient.value)
    sd = in_expected_sizes(coefficient, coefficient.sd)
    expected = f"{text.fixed(value, 2)} ± {text.fixed(sd, 2)}"
    unit, factor = units.coefficient_unit(coefficient.unit)
    return [
        spoken(coefficient.effect),
        f"{coefficient.name} [{text.unit_symbol(unit)}]",
        text.number(coefficient.value / factor),
        text.number(coefficient.sd / factor, 2),
        text.MISSING if math.isnan(value) else expected,
    ]


def in_expected_sizes(coefficient: CoefficientRecord, number: float) -> float:
    """A value or sd over the expected size; NaN where that is not known."""
    size = coefficient.prior_sd
    return math.nan if size is None or not size > 0.0 else number / size
