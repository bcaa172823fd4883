"""Blocks on the uncertainty budget: its lines, what to improve, effects outside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from oed.result import BudgetLine, BudgetSection, ComponentAccuracy, UnmodelledLine
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)

#: decimals of a share that count
NEGLIGIBLE: Final = 5
Components = Mapping[str, ComponentAccuracy]
#: what each kind of line is
KINDS: Final = {
    "instrument": "the stated noise of single readings",
    "run": "errors that the readings of a run share",
    "course": "errors that all runs share in the course of the session",
    "noise law": "noise beyond the stated one, and what is not known of it",
    "set-up": "what the unknowns of the set-ups cost: where a cup or a tracker stands",
    "effects": "what is not known of the effects in the model",
    "prior": "what the readings leave to the tolerances",
    "unmodelled": "what is not known of effects beside the geometry",
    "linearisation": "what a linear calculation leaves out",
    "interpolation": "what lies between the nodes of a grid",
    "rounding": "printed digits",
}


def blocks(section: BudgetSection, components: Components) -> list[Block]:
    """The lines, the accuracy without each, advice, and effects that are not modelled."""
    shown = [n for n, c in components.items() if c.compensatable] or list(components)
    units = {name: components[name].after.unit for name in shown}
    content: list[Block] = [_lines(section, units), _improvements(section, units)]
    if section.no_axes:
        content.append(_axes(section, components))
    if section.advice:
        content.append(Paragraph(" ".join(section.advice)))
    if section.unmodelled:
        after = {name: components[name].after.rms for name in shown}
        content.append(_unmodelled(section.unmodelled, after, units))
        hidden = [u for u in section.unmodelled if u.not_testable]
        if hidden:
            content.append(Paragraph(_hidden(hidden)))
    return content


def _axes(section: BudgetSection, components: Components) -> Table:
    """What no drive corrects, without and with additional axes."""
    rows = [
        [
            f"{name} [{text.unit_symbol(components[name].after.unit)}]",
            text.number(without),
            text.number(section.predicted[name]),
        ]
        for name, without in section.no_axes.items()
    ]
    columns = [
        TableColumn("Component"),
        *number_columns("Without additional axes", "With additional axes"),
    ]
    caption = (
        "Rms error of what no drive of this machine corrects, and what stays where"
        " additional axes take the known error back."
    )
    return Table(columns, rows, caption)


def _lines(section: BudgetSection, units: Mapping[str, str]) -> Table:
    columns = [TableColumn("Source"), wide_column("What it is")]
    for name, unit in units.items():
        columns += number_columns(f"{name} [{text.unit_symbol(unit)}]", "share")
    rows = []
    for line in section.lines:
        row = [line.source, KINDS.get(line.kind, line.kind)]
        for name in units:
            share = round(line.share[name], NEGLIGIBLE)
            row += [text.number(line.size[name]), text.percent(share)]
        rows.append(row)
    total = ["all", "predicted rms error"]
    for name in units:
        total += [text.number(section.predicted[name]), "100 %"]
    caption = (
        "Uncertainty budget: what each source adds when those above it are gone, and its"
        " share of the predicted variance. The shares add up to 100 %; a negative one means"
        " that other lines count part of it as well."
    )
    return Table(columns, [*rows, total], caption)


def _improvements(section: BudgetSection, units: Mapping[str, str]) -> Table:
    columns = [TableColumn("Source")]
    for name, unit in units.items():
        columns += number_columns(
            f"{name} halved [{text.unit_symbol(unit)}]", "without"
        )
    rows = [
        _improvement(line, list(units))
        for line in section.lines
        if line.without is not None
    ]
    caption = (
        "Rms error that would remain with half of one source's standard deviation, and"
        " without that source."
    )
    return Table(columns, rows, caption)


def _improvement(line: BudgetLine, names: Sequence[str]) -> list[str]:
    row = [line.source]
    for name in names:
        for values in (line.halved, line.without):
            row.append("" if values is None else text.number(values[name]))
    return row


def _unmodelled(
    lines: Sequence[UnmodelledLine],
    after: Mapping[str, float],
    units: Mapping[str, str],
) -> Table:
    columns = [TableColumn("Effect"), TableColumn("Expected size")]
    for name, unit in units.items():
        columns += number_columns(f"{name} [{text.unit_symbol(unit)}]")
    columns.append(wide_column("What to do"))
    rows = [["none: geometry alone", "", *(text.number(v) for v in after.values()), ""]]
    for line in lines:
        values = [text.number(line.with_it[name]) for name in after]
        rows.append([line.effect, line.expected, *values, line.remedy])
    caption = (
        "What usually goes unmodelled: rms error of the compensated machine if one"
        " effect has its expected size and the calibration does not know of it. What an"
        " effect adds grows in proportion to its size, and 30 times the expected size is"
        " usual."
    )
    return Table(columns, rows, caption)


def _hidden(lines: Sequence[UnmodelledLine]) -> str:
    reasons: dict[str, list[str]] = {}
    for line in lines:
        reasons.setdefault(line.not_testable or "", []).append(line.effect)
    parts = [
        f"{text.listing(effects)} ({reason})" for reason, effects in reasons.items()
    ]
    return f"These readings cannot find {text.listing(parts)}."
