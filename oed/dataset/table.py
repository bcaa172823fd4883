"""A readings file (`*.readings.csv`) as a table of checked cells, without a machine.

One row a reading, a header with the unit in each column's name. Rows are counted as a
spreadsheet shows them. Remarks, and lines with # above the header, are not read.
"""

from __future__ import annotations

import csv
import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from oed import units
from oed.base import Array, Index
from oed.dataset import dialect, table_cells
from oed.dataset.columns import (
    LABELS,
    REQUIRED,
    UNITLESS,
    ReadingsColumn,
    column_names,
    parse_column,
)
from oed.dataset.dialect import Row, SplitText
from oed.dataset.readings_file import FILE, ROW, ReadingsError, ReadingsFile
from oed.dataset.table_checks import check_rows

MAX_BYTES: Final = 64_000_000
#: readings of one session, each a value of a channel: with these a check takes about a
#: gigabyte, and a diagnosis some four
MOST_READINGS: Final = 50_000
MAX_COLUMNS: Final = 200
HEADER_REMEDY: Final = (
    "the first line names the columns: setup,run,order, then a pose and a reading such"
    " as z_mm,length_mm"
)
ENCODING_REMEDY: Final = "save it as CSV in UTF-8"


def read(
    path: Path,
    expected: Mapping[str, str] | None = None,
    poses: Sequence[Sequence[str]] = (),
) -> ReadingsFile:
    """Read and check one file.

    `expected` are stems with SI units that the caller knows, `poses` groups of stems
    that only together give a pose: they make remedies exact. Raises ReadingsError for
    the first problem, OSError where the file is not there.
    """
    split = dialect.split(_text(path))
    rows = _rows(split, str(path))
    return from_rows(rows, str(path), expected, split.separator, poses)


def from_rows(
    rows: Iterable[Row],
    file: str,
    expected: Mapping[str, str] | None = None,
    separator: str = ",",
    poses: Sequence[Sequence[str]] = (),
) -> ReadingsFile:
    """Make a table from numbered rows of cells, the header first; else as `read`.

    Numbers may have decimal commas where `separator` is another sign.
    """
    rows = iter(rows)
    header = next(rows, None)
    if header is None:
        problem = "there is no header below the comments"
        raise ReadingsError(problem, HEADER_REMEDY, file=file)
    columns = _header(header, file, expected or {})
    names = [cell.strip() for cell in header[1]]
    places = {stem: names.index(column.name) for stem, column in columns.items()}

    def convert(stem: str, text: Sequence[str], numbers: Index) -> Array:
        points = dialect.with_decimal_points(text, separator)
        remedy = cell_remedy(stem, poses)
        return table_cells.numbers_of(columns[stem], points, numbers, file, remedy)

    cells = table_cells.by_column(rows, places, convert)
    if not len(cells.rows):
        raise ReadingsError(
            "there are no readings below the header", "add one row a reading", file=file
        )
    frame = pd.DataFrame({FILE: file, ROW: cells.rows, **cells.columns})
    table = ReadingsFile(file, frame, columns)
    check_rows(table)
    frame["order"] = frame["order"].astype(np.int64)
    return table


def _text(path: Path) -> str:
    size = path.stat().st_size
    file = str(path)
    if not path.is_file():
        raise ReadingsError("this is no file", "name a readings file", file=file)
    if size > MAX_BYTES:
        largest = f"{MAX_BYTES / units.MEGABYTE:.0f} MB"
        problem = f"{size / units.MEGABYTE:.0f} MB is too large for readings"
        raise ReadingsError(problem, f"split it: at most {largest}", file=file)
    try:
        text = dialect.decode(path.read_bytes())
    except UnicodeDecodeError as error:
        problem = f"the file is no UTF-8 text (byte {error.start + 1})"
        raise ReadingsError(problem, ENCODING_REMEDY, file=file) from None
    if not text.strip():
        raise ReadingsError("the file is empty", HEADER_REMEDY, file=file)
    if "\0" in text:
        problem = "the file holds NUL characters"
        raise ReadingsError(problem, ENCODING_REMEDY, file=file)
    return text


def too_many(count: int, what: str, file: str) -> ReadingsError:
    """The error for `count` readings, or rows of them, which are too many."""
    step = -(-count // MOST_READINGS)
    return ReadingsError(
        f"about {count} {what} are too many: a session has at most {MOST_READINGS}"
        " readings, counted by channel",
        f"keep one row in {step} of each run, or check and fit the runs in parts",
        file=file,
    )


def _rows(split: SplitText, file: str) -> Iterator[Row]:
    """Numbered rows of cells, blank ones left out. Raises ReadingsError if ragged."""
    names: list[str] = []
    count = 0
    try:
        for number, cells in split.rows():
            if count > MOST_READINGS:
                raise too_many(split.text.count("\n") - 1, "rows", file)
            if not count:
                names = [name.strip() for name in cells]
            elif len(cells) != len(names) or "" in names:
                cells = _in_columns(cells, names, number, file)
            yield number, cells
            count += 1
    except csv.Error:
        row = count + 1 + split.comments
        problem = "the lines are no CSV"
        raise ReadingsError(problem, HEADER_REMEDY, file=file, row=row) from None


def _in_columns(
    cells: Sequence[str], names: Sequence[str], number: int, file: str
) -> Sequence[str]:
    """One cell a column. Only remarks may be missing at the end, or empty cells follow.

    Raises ReadingsError.
    """
    missing, surplus = names[len(cells) :], cells[len(names) :]
    if any(cell.strip() for cell in surplus) or not all(
        map(dialect.is_unread, missing)
    ):
        raise ReadingsError(
            f"{len(cells)} cells, but the header has {len(names)}",
            "give one cell a column, empty where there is none",
            file=file,
            row=number,
        )
    row = [*cells[: len(names)], *[""] * len(missing)]
    for name, cell in zip(names, row, strict=True):
        if not name and cell.strip():
            raise ReadingsError(
                "the column has no name",
                "name it in the header: a text for yourself is a remark",
                file=file,
                row=number,
                column="?",
                value=cell.strip(),
            )
    return row


def _header(
    header: Row, file: str, expected: Mapping[str, str]
) -> dict[str, ReadingsColumn]:
    """Columns by stem, in order. Raises ReadingsError."""
    row, cells = header
    names = [cell.strip() for cell in cells]
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise ReadingsError(
            f"the column {missing[0]} is missing",
            HEADER_REMEDY,
            file=file,
            row=row,
            column=missing[0],
        )
    if len(names) > MAX_COLUMNS:
        problem = f"{len(names)} columns are too many"
        raise ReadingsError(problem, HEADER_REMEDY, file=file, row=row)
    columns: dict[str, ReadingsColumn] = {}
    for name in names:
        if dialect.is_unread(name):
            continue
        column = _column(name, file, row, expected)
        if column.stem in columns:
            problem = f"{column.stem} is given twice"
            remedy = f"keep {columns[column.stem].name} or {name}"
            raise ReadingsError(problem, remedy, file=file, row=row, column=name)
        columns[column.stem] = column
    return columns


def _column(
    name: str, file: str, row: int, expected: Mapping[str, str]
) -> ReadingsColumn:
    try:
        return parse_column(name)
    except units.UnitError:
        raise ReadingsError(
            "no known unit in the name",
            _unit_remedy(name, expected),
            file=file,
            row=row,
            column=name,
        ) from None


def _unit_remedy(name: str, expected: Mapping[str, str]) -> str:
    """Remedy for a column without a known unit."""
    for stem in (name, name.rpartition("_")[0]):
        if stem in expected:
            return f"write {', '.join(column_names(stem, expected[stem]))}"
    near = difflib.get_close_matches(name, (*UNITLESS, *LABELS), n=1, cutoff=0.7)
    if near:
        return f"did you mean {near[0]}?"
    return f"end it in a known unit: {', '.join(units.UNITS)}"


def cell_remedy(stem: str, poses: Sequence[Sequence[str]]) -> str:
    """What to do about a cell that is wrong, or empty where it may not be.

    poses  groups of stems that only together give a pose; none where they are not known
    """
    if not poses:
        return "correct the number; only readings and covariates may be left empty"
    for group in poses:
        if stem in group:
            return (
                f"write the number: each row of a set-up has all of {', '.join(group)}"
            )
    return "correct the number, or leave the cell empty where none was read"
