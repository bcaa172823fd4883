"""Blocks on how far single machines differ, on other references and other tools."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from oed.result import PredictionSection, SpreadRecord, ToolAccuracy
from pkm_reports import text
from pkm_reports.blocks import Block, Table, TableColumn, number_columns

NAMES: Final = {
    "absolute": "absolute",
    "home": "zeroed at home",
    "best_fit": "best rigid fit",
}


def blocks(prediction: PredictionSection) -> list[Block]:
    """Intervals over machines, each reference, each tool; what is stored of them."""
    content: list[Block] = []
    after = {name: c.after for name, c in prediction.components.items()}
    if any(spread.rms_interval for spread in after.values()):
        content.append(_intervals(after))
    if prediction.references:
        content.append(_references(prediction.references))
    if prediction.tools:
        content.append(_tools(prediction.tools))
    return content


def _intervals(after: Mapping[str, SpreadRecord]) -> Table:
    columns = [TableColumn("Component"), *number_columns("rms", "p95", "max")]
    rows = []
    for name, spread in after.items():
        cells = [_span(spread, figure) for figure in ("rms", "p95", "max")]
        rows.append([f"{name} [{text.unit_symbol(spread.unit)}]", *cells])
    caption = (
        "What a single machine can expect of the geometry alone: 95 % of the machines have"
        " these figures over their workspace between these ends."
    )
    return Table(columns, rows, caption)


def _span(spread: SpreadRecord, figure: str) -> str:
    """Both ends of the interval of a figure, empty without one."""
    ends = getattr(spread, f"{figure}_interval")
    if ends is None:
        return ""
    errors = spread.monte_carlo.get(f"{figure}_interval", [math.nan, math.nan])
    low, high = (text.drawn(v, e) for v, e in zip(ends, errors, strict=True))
    return f"{low} to {high}"


def _references(references: Mapping[str, Mapping[str, SpreadRecord]]) -> Table:
    columns = [TableColumn("Component")]
    for name in references:
        columns += number_columns(f"{text.meaning(name, NAMES)}: rms", "p95", "max")
    components = next(iter(references.values()))
    rows = []
    for name, spread in components.items():
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]"]
        for spreads in references.values():
            cells += figures(spreads[name])
        rows.append(cells)
    caption = "Errors after compensation against each reference."
    return Table(columns, rows, caption)


def figures(spread: SpreadRecord) -> list[str]:
    """Rms, 95th percentile and largest error, with the digits that the draws allow."""
    cells = []
    for name in ("rms", "p95", "max"):
        error = next(iter(spread.monte_carlo.get(name, [])), math.nan)
        cells.append(text.drawn(getattr(spread, name), error))
    return cells


def _tools(tools: Sequence[ToolAccuracy]) -> Table:
    columns = [TableColumn("Component")]
    for tool in tools:
        length = text.quantity(tool.length, tool.unit)
        columns += number_columns(f"{length}: rms", "p95", "max")
    rows = []
    for name, spread in tools[0].components.items():
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]"]
        for tool in tools:
            cells += figures(tool.components[name])
        rows.append(cells)
    caption = "Errors after compensation at tools longer than the reference one."
    return Table(columns, rows, caption)
