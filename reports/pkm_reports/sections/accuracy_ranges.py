"""Blocks on how far single machines differ, on other references and other tools."""

from __future__ import annotations

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
        ends = (spread.rms_interval, spread.p95_interval, spread.max_interval)
        cells = ["" if e is None else _span(e) for e in ends]
        rows.append([f"{name} [{text.unit_symbol(spread.unit)}]", *cells])
    caption = (
        "What a single machine can expect after compensation: 95 % of the machines have"
        " these figures over their workspace between these ends."
    )
    return Table(columns, rows, caption)


def _span(ends: tuple[float, float]) -> str:
    low, high = ends
    return f"{text.number(low)} to {text.number(high)}"


def _references(references: Mapping[str, Mapping[str, SpreadRecord]]) -> Table:
    columns = [TableColumn("Component")]
    for name in references:
        columns += number_columns(f"{text.meaning(name, NAMES)}: rms", "p95", "max")
    components = next(iter(references.values()))
    rows = []
    for name, spread in components.items():
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]"]
        for spreads in references.values():
            cells += _figures(spreads[name])
        rows.append(cells)
    caption = "Errors after compensation against each reference."
    return Table(columns, rows, caption)


def _figures(spread: SpreadRecord) -> list[str]:
    return [text.number(v) for v in (spread.rms, spread.p95, spread.max)]


def _tools(tools: Sequence[ToolAccuracy]) -> Table:
    columns = [TableColumn("Component")]
    for tool in tools:
        length = text.quantity(tool.length, tool.unit)
        columns += number_columns(f"{length}: rms", "p95", "max")
    rows = []
    for name, spread in tools[0].components.items():
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]"]
        for tool in tools:
            cells += _figures(tool.components[name])
        rows.append(cells)
    caption = "Errors after compensation at tools longer than the reference one."
    return Table(columns, rows, caption)
