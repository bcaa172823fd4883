"""Rows of the design benchmark and their table, as plain text and as Markdown."""

from __future__ import annotations

import dataclasses

import numpy as np

HEADER = ["problem", "method", "value", "seconds", "ratio", "bound", "note"]
#: two values that differ by less than this are equally good
EQUAL = 1e-9


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of the table.

    value    criterion value; None where there is no result, and `note` says why
    seconds  processor time of the choice
    bound    upper bound of the value, where the method gives one
    ours     whether the method belongs to this project
    """

    problem: str
    method: str
    value: float | None = None
    seconds: float | None = None
    bound: float | None = None
    note: str = ""
    ours: bool = False

    @property
    def rank_value(self) -> float:
        """The value for comparisons; -inf where there is none."""
        return -np.inf if self.value is None else self.value


def sort(rows: list[Row]) -> list[Row]:
    """Rows by problem in order of appearance: this project first, others by value."""
    problems = list(dict.fromkeys(row.problem for row in rows))

    def rank(row: Row) -> tuple[int, bool, float]:
        by_value = 0.0 if row.ours else -row.rank_value
        return problems.index(row.problem), not row.ours, by_value

    return sorted(rows, key=rank)


def select_best(rows: list[Row]) -> list[Row]:
    """Every row of this project, and the best row of each package a problem."""
    best: dict[tuple[str, str], Row] = {}
    for row in rows:
        package = row.method if row.ours else row.method.split(",")[0]
        key = row.problem, package
        if key not in best or row.rank_value > best[key].rank_value:
            best[key] = row
    selected = list(best.values())
    return [row for row in rows if any(row is other for other in selected)]


def cells(rows: list[Row]) -> list[list[str]]:
    """Texts of the table; ratios are to this project's best row of the problem."""
    units = _unit_rows(rows)
    return [_row_cells(row, units.get(row.problem)) for row in rows]


def _unit_rows(rows: list[Row]) -> dict[str, Row]:
    """This project's best row of each problem."""
    units: dict[str, Row] = {}
    for row in rows:
        if not row.ours or row.value is None:
            continue
        unit = units.get(row.problem)
        if unit is None or row.rank_value > unit.rank_value + EQUAL:
            units[row.problem] = row
    return units


def _row_cells(row: Row, unit: Row | None) -> list[str]:
    return [
        row.problem,
        row.method,
        _text(row.value, ".4f"),
        _text(row.seconds, ".3g"),
        _ratio(row, unit),
        _text(row.bound, ".4f"),
        row.note or "-",
    ]


def _text(number: float | None, form: str) -> str:
    return "-" if number is None else format(number, form)


def _ratio(row: Row, unit: Row | None) -> str:
    if row.seconds is None or unit is None or not unit.seconds:
        return "-"
    ratio = row.seconds / unit.seconds
    return f"{ratio:.0f}" if ratio >= 10.0 else f"{ratio:.2g}"


def format_text(rows: list[Row]) -> str:
    """The table with aligned columns."""
    lines = [HEADER, *cells(rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(HEADER))]
    padded = [
        [cell.ljust(width) for cell, width in zip(line, widths, strict=True)]
        for line in lines
    ]
    return "\n".join("  ".join(line).rstrip() for line in padded)


def format_markdown(rows: list[Row]) -> str:
    """The best rows as Markdown; the note stands only where there is no value."""
    lines = [HEADER[:-1], ["---", "---", "--:", "--:", "--:", "--:"]]
    for problem, method, value, *numbers, note in cells(select_best(rows)):
        lines.append([problem, method, note if value == "-" else value, *numbers])
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
