"""A readings file (`*.readings.csv`) as a table of checked cells, without a machine.

One row a reading, a header with the unit in each column's name. Rows are counted as a
spreadsheet shows them. Remarks, and lines with # above the header, are not read.
"""

from __future__ import annotations

import csv
import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from oed.base import csv_text, units
from oed.base.arrays import Array
from oed.dataset import dialect
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
#: size of a number in a cell beyond which it is a slip
LARGEST: Final = 1e12


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
    rows = _rows(split, str(path), expected or {})
    if not rows:
        problem = "there is no header below the comments"
        raise ReadingsError(problem, HEADER_REMEDY, file=str(path))
    return from_rows(rows, str(path), expected, split.separator, poses)


def from_rows(
    rows: Sequence[Row],
    file: str,
    expected: Mapping[str, str] | None = None,
    separator: str = ",",
    poses: Sequence[Sequence[str]] = (),
) -> ReadingsFile:
    """Make a table from numbered rows of cells, the header first; else as `read`.

    Numbers may have decimal commas where `separator` is another sign.
    """
    columns = _header(rows[0], file, expected or {})
    body = rows[1:]
    if not body:
        raise ReadingsError(
            "there are no readings below the header", "add one row a reading", file=file
        )
    numbers = np.array([number for number, _ in body])
    frame = pd.DataFrame({FILE: file, ROW: numbers})
    names = [cell.strip() for cell in rows[0][1]]
    for stem, column in columns.items():
        k = names.index(column.name)
        text = [csv_text.plain(cells[k].strip()) for _, cells in body]
        is_label = stem in LABELS
        points = dialect.with_decimal_points(text, separator)
        if is_label:
            frame[stem] = text
            continue
        remedy = cell_remedy(stem, poses)
        frame[stem] = _numbers(column, points, numbers, file, remedy)
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


def _rows(split: SplitText, file: str, expected: Mapping[str, str]) -> list[Row]:
    """Numbered rows of cells, blank ones left out. Raises ReadingsError if ragged."""
    rows: list[Row] = []
    try:
        for number, cells in split.rows():
            if len(rows) > MOST_READINGS:
                raise too_many(split.text.count("\n") - 1, "rows", file)
            if rows:
                rows.append((number, _in_columns(cells, rows[0][1], number, file)))
            else:
                _header((number, cells), file, expected)
                rows.append((number, cells))
    except csv.Error:
        raise ReadingsError(
            "the lines are no CSV",
            HEADER_REMEDY,
            file=file,
            row=len(rows) + 1 + split.comments,
        ) from None
    return rows


def _in_columns(
    cells: Sequence[str], header: Sequence[str], number: int, file: str
) -> Sequence[str]:
    """One cell a column. Only remarks may be missing at the end, or empty cells follow.

    Raises ReadingsError.
    """
    names = [name.strip() for name in header]
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


def _numbers(
    column: ReadingsColumn,
    text: Sequence[str],
    rows: np.ndarray,
    file: str,
    remedy: str,
) -> Array:
    """SI values (n,) of a column, NaN where the cell is empty. Raises ReadingsError."""
    cells = pd.Series(text, dtype=object)
    parsed = pd.to_numeric(cells, errors="coerce")
    values = parsed.to_numpy(dtype=float, na_value=np.nan)
    filled = (cells != "").to_numpy()
    bad = np.flatnonzero(filled & ~np.isfinite(values))
    if bad.size:
        k = int(bad[0])
        if "," in text[k] and "." in text[k]:
            remedy = "write one decimal sign, and no sign between thousands"
        elif "," in text[k]:
            remedy = "write decimals with a point"
        raise ReadingsError(
            "not a finite number",
            remedy,
            file=file,
            row=int(rows[k]),
            column=column.name,
            value=text[k],
        )
    huge = np.flatnonzero(filled & (np.abs(values) > LARGEST))
    if huge.size:
        k = int(huge[0])
        raise ReadingsError(
            "no number of a session is so large",
            remedy,
            file=file,
            row=int(rows[k]),
            column=column.name,
            value=text[k],
        )
    return np.asarray(values * column.factor)
