"""A readings file (`*.readings.csv`) as a table of checked cells, without a machine.

One row a reading, a header with the unit in each column's name. Rows are counted as a
spreadsheet shows them. Remarks, and lines with # above the header, are not read.
"""

import csv
import difflib
import itertools
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from oed import csv_text, units
from oed.base import Array, Index, Mask
from oed.dataset import dialect
from oed.dataset.columns import (
    LABELS,
    REQUIRED,
    SIGMA,
    TENSION,
    UNITLESS,
    ReadingsColumn,
    column_names,
)
from oed.dataset.dialect import Row, SplitText
from oed.dataset.readings_file import FILE, ROW, ReadingsError, ReadingsFile

# What no table of readings may have: labels, orders and signs that contradict.

ORDER_REMEDY: Final = "count the readings of a run in time: 1, 2, 3"
#: least value of a covariate
MIN_COVARIATES: Final = {"time": 0, "feed": 0, "repeat": 1}
#: least and largest standard deviation of a reading, SI
SIGMA_RANGE: Final = (1e-12, 1e3)
SIGMA_PROBLEM: Final = "no reading has such a standard deviation"
SIGMA_REMEDY: Final = (
    "give a number above 0 in the column's unit, or leave the cell empty: then that of"
    " [noise] holds"
)
MAX_ORDER: Final = 1e15  #: orders stay below this


class Rule(NamedTuple):
    """What rows of a column break, and what to do about it."""

    stem: str
    broken: Mask  #: (n,) rows
    problem: str
    remedy: str


def check_rows(table: ReadingsFile) -> None:
    """Raises ReadingsError for the first row that contradicts itself."""
    for stem, broken, problem, remedy in _rules(table):
        rows = np.flatnonzero(broken)
        if rows.size:
            raise table.error(problem, remedy, int(rows[0]), stem)


def _rules(table: ReadingsFile) -> Iterator[Rule]:
    """Of labels, orders, directions, covariates and standard deviations, in turn."""
    frame = table.frame
    for stem in LABELS:
        empty = (frame[stem] == "").to_numpy()
        yield Rule(stem, empty, "the cell is empty", f"name the {stem} of every row")
    order = frame["order"].to_numpy()
    whole = (order >= 0) & (order < MAX_ORDER) & (order == np.round(order))
    problem = "order is no whole number from 0 on"
    yield Rule("order", ~whole, problem, ORDER_REMEDY)
    if "direction" in frame:
        direction = frame["direction"].to_numpy()
        wrong = np.isfinite(direction) & (np.abs(direction) != 1.0)
        remedy = "write 1 or -1, or leave it empty"
        yield Rule("direction", wrong, "direction is +1 or -1", remedy)
    # times count from the session's start, feeds are speeds, cables do not push
    least_values = dict(MIN_COVARIATES)
    least_values |= {s: 0 for s in table.columns if s.startswith(TENSION)}
    for stem, least in least_values.items():
        if stem in frame:
            below = frame[stem].to_numpy() < least
            remedy = "correct it, or leave the cell empty where it is unknown"
            yield Rule(stem, below, f"{stem} is at least {least}", remedy)
    smallest, most = SIGMA_RANGE
    for stem in table.columns:
        if stem.startswith(SIGMA):
            values = frame[stem].to_numpy(dtype=float)
            bad = np.isfinite(values) & ~((values >= smallest) & (values <= most))
            yield Rule(stem, bad, SIGMA_PROBLEM, SIGMA_REMEDY)


# Cells of a table in columns, from rows of text, converted block by block.
#
# Text cells take some forty bytes each, however short they are; numbers take eight.

ROWS_AT_ONCE: Final = 10_000  #: rows whose cells are in memory as text at once
MAX_NUMBER: Final = 1e12  #: size of a number in a cell beyond which it is a slip

#: SI values (n,) of cells of a column, by its stem, with the numbers (n,) of their rows
Convert = Callable[[str, Sequence[str], Index], Array]


def convert_columns(
    rows: Iterable[Row], places: Mapping[str, int], convert: Convert
) -> tuple[Index, dict[str, Sequence[str] | Array]]:
    """Numbers (n,) of rows of cells in their file, and their columns by stem: labels, or SI
    values (n,), NaN where a cell is empty. `places` are those of stems in a row.

    Rows are all read before the first cell that `convert` refuses is reported, in the
    order of the columns. Raises ReadingsError.
    """
    numbers: list[Index] = []
    labels: dict[str, list[str]] = {stem: [] for stem in places if stem in LABELS}
    parts: dict[str, list[Array]] = {stem: [] for stem in places if stem not in LABELS}
    refused: dict[str, ReadingsError] = {}
    for block in _blocks(rows):
        numbers.append(np.array([number for number, _ in block], dtype=np.intp))
        for stem, k in places.items():
            text = [csv_text.plain(cells[k].strip()) for _, cells in block]
            if stem in labels:
                labels[stem] += map(sys.intern, text)
            elif stem not in refused:
                try:
                    parts[stem].append(convert(stem, text, numbers[-1]))
                except ReadingsError as error:
                    refused[stem] = error
    for stem in places:
        if stem in refused:
            raise refused[stem]
    every = np.concatenate([np.zeros(0, dtype=np.intp), *numbers])
    values = {stem: np.concatenate([np.empty(0), *p]) for stem, p in parts.items()}
    return every, {stem: (labels | values)[stem] for stem in places}


def _blocks(rows: Iterable[Row]) -> Iterator[list[Row]]:
    remaining = iter(rows)
    while block := list(itertools.islice(remaining, ROWS_AT_ONCE)):
        yield block


def numbers_of(
    column: ReadingsColumn, text: Sequence[str], rows: Index, file: str, remedy: str
) -> Array:
    """SI values (n,) of a column, NaN where the cell is empty. Raises ReadingsError."""
    import pandas as pd  # names and limits of columns need no tables

    cells = pd.Series(text, dtype=object)
    parsed = pd.to_numeric(cells, errors="coerce")
    values = parsed.to_numpy(dtype=float, na_value=np.nan)
    filled = (cells != "").to_numpy()
    problem = "not a finite number"
    bad = filled & ~np.isfinite(values)
    if not bad.any():
        problem = "no number of a session is so large"
        bad = filled & (np.abs(values) > MAX_NUMBER)
    for k in np.flatnonzero(bad)[:1]:
        if "," in text[k] and "." in text[k]:
            remedy = "write one decimal sign, and no sign between thousands"
        elif "," in text[k]:
            remedy = "write decimals with a point"
        raise ReadingsError(
            problem,
            remedy,
            file=file,
            row=int(rows[k]),
            column=column.name,
            value=text[k],
        )
    return np.asarray(values * column.factor)


MAX_BYTES: Final = 64_000_000
#: readings of one session, each a value of a channel: with these a check takes about a
#: gigabyte, and a diagnosis some four
MAX_READINGS: Final = 50_000
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
    split = SplitText.of(_text(path))
    rows = _rows(split, str(path))
    return from_rows(rows, str(path), expected, split.separator, poses)


def count_rows(path: Path) -> int:
    """The number of rows of a file, which is checked. Raises as `read` does."""
    return len(read(path).frame)


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
        return numbers_of(columns[stem], points, numbers, file, remedy)

    numbers, cells = convert_columns(rows, places, convert)
    if not len(numbers):
        raise ReadingsError(
            "there are no readings below the header", "add one row a reading", file=file
        )
    import pandas as pd

    frame = pd.DataFrame({FILE: file, ROW: numbers, **cells})
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
    step = -(-count // MAX_READINGS)
    return ReadingsError(
        f"about {count} {what} are too many: a session has at most {MAX_READINGS}"
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
            if count > MAX_READINGS:
                raise too_many(split.text.count("\n") - 1, "rows", file)
            if not count:
                names = [name.strip() for name in cells]
            elif len(cells) != len(names) or "" in names:
                cells = _cells_in_columns(cells, names, number, file)
            yield number, cells
            count += 1
    except csv.Error:
        row = count + 1 + split.comments
        problem = "the lines are no CSV"
        raise ReadingsError(problem, HEADER_REMEDY, file=file, row=row) from None


def _cells_in_columns(
    cells: Sequence[str], names: Sequence[str], number: int, file: str
) -> Sequence[str]:
    """One cell a column, or fewer where the last are remarks. Raises ReadingsError."""
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
    if len(names) > 200:
        problem = f"{len(names)} columns are too many"
        raise ReadingsError(problem, HEADER_REMEDY, file=file, row=row)
    columns: dict[str, ReadingsColumn] = {}
    for name in names:
        if dialect.is_unread(name):
            continue
        column = _column(name, file, row, expected)
        if column.stem in columns:
            problem = f"{column.stem} is given twice"
            other = columns[column.stem].name
            remedy = f"keep {other} or {name}" if other != name else "keep one of them"
            raise ReadingsError(problem, remedy, file=file, row=row, column=name)
        columns[column.stem] = column
    return columns


def _column(
    name: str, file: str, row: int, expected: Mapping[str, str]
) -> ReadingsColumn:
    try:
        return ReadingsColumn.parse(name)
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
    near = difflib.get_close_matches(name, UNITLESS, n=1, cutoff=0.7)
    if near:
        return f"did you mean {near[0]}?"
    return f"end it in a known unit: {', '.join(units.UNITS)}"


def cell_remedy(stem: str, poses: Sequence[Sequence[str]]) -> str:
    """What to do about a wrong or empty cell, by stems that together give a pose."""
    if not poses:
        return "correct the number; only readings and covariates may be left empty"
    for group in poses:
        if stem in group:
            return (
                f"write the number: each row of a set-up has all of {', '.join(group)}"
            )
    return "correct the number, or leave the cell empty where none was read"
