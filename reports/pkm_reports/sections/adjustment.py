"""Chapter: what to adjust at the machine, and the page for the fitter."""

from __future__ import annotations

from typing import Final

from oed.result import AdjustmentLine, AdjustmentSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Table,
    TableColumn,
    headed_list,
    number_columns,
    wide_column,
)

#: columns of the fitter's page to write in
TO_FILL_IN: Final = ("Done", "Measured")
NOTHING: Final = (
    "No adjustment is worth its work: software corrects what the adjustments would."
)


def blocks(result: StudyResult) -> list[Block]:
    """The lines, and the accuracy after each."""
    section = result.adjustment
    if section is None:
        return []
    if not section.lines:
        return [Paragraph(f"{NOTHING} Total: {section.about}."), _accuracy(section)]
    return [
        Paragraph(_introduction(section)),
        _lines(section),
        _accuracy(section),
        *headed_list("The figures rest on:", section.conditions),
    ]


def adjustment_blocks(section: AdjustmentSection) -> list[Block]:
    """What the fitter's page has, with room to write."""
    return [
        Paragraph(_introduction(section)),
        _lines(section, TO_FILL_IN),
        _accuracy(section),
    ]


def _introduction(section: AdjustmentSection) -> str:
    ends = [section.accuracy[k].total for k in (0, -1)]
    first, last = (text.quantity(total, section.total_unit) for total in ends)
    return (
        f"{text.count(len(section.lines), 'adjustment')} bring the total error after"
        f" compensation by software from {first} to {last}."
        f" Total: {section.about}. Without any one of the lines it is more than 5 %"
        " larger. Give the controller the parameters after the adjustment (oed compensate"
        " --adjusted), then measure again."
    )


def _lines(section: AdjustmentSection, further: tuple[str, ...] = ()) -> Table:
    columns = [
        TableColumn("No."),
        TableColumn("Adjustment"),
        *number_columns("Amount", "Steps"),
        wide_column("Moves"),
        *number_columns("Without it"),
        *(TableColumn(title) for title in further),
    ]
    rows = [
        [str(k), *_line(line, section.total_unit), *[""] * len(further)]
        for k, line in enumerate(section.lines, start=1)
    ]
    caption = (
        "Adjustments in working order. “Without it”: total error of the list without this"
        " line, with the others chosen anew."
    )
    return Table(columns, rows, caption)


def _line(line: AdjustmentLine, total_unit: str) -> list[str]:
    return [
        line.by,
        signed(line),
        "" if line.steps is None else f"{line.steps:+d}".replace("-", "−"),
        f"{line.about} ({line.parameter})",
        text.quantity(line.without, total_unit),
    ]


def signed(line: AdjustmentLine) -> str:
    """The amount with its sign and unit: `+0.34 mm`."""
    sign = "+" if line.amount > 0.0 else ""
    return sign + text.append_unit(text.trimmed(line.amount, 6), line.unit)


def _accuracy(section: AdjustmentSection) -> Table:
    units = section.unit.items()
    titles = [f"{name} [{text.unit_symbol(unit)}]" for name, unit in units]
    columns = [
        TableColumn("After"),
        TableColumn("Controller"),
        *number_columns("Total", *titles),
    ]
    rows = []
    for k, record in enumerate(section.accuracy):
        after = f"line {k}" if k else "nothing"
        plain = [text.number(v) for v in record.plain.values()]
        corrected = [text.number(v) for v in record.corrected.values()]
        rows.append([after, "as it is", "", *plain])
        total = text.quantity(record.total, section.total_unit)
        rows.append(["", "compensated", total, *corrected])
    caption = (
        f"Predicted rms errors over {section.poses} poses, reference"
        f" {section.reference}, after each line: with the nominal numbers in the"
        " controller, and once software compensates all that is known."
    )
    return Table(columns, rows, caption)


CHAPTER: Final = Chapter("adjustment", "Adjustments at the machine", blocks, blocks)
