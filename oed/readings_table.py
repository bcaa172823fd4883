"""The text of a readings file (`*.readings.csv`) as a table of checked cells, before
any machine is asked.

One row a reading, UTF-8, commas, a header with the unit in each column's name. Rows are
counted as a spreadsheet shows them: the header is row 1.
"""

from __future__ import annotations

import csv
import dataclasses
import difflib
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from oed import units

MAX_BYTES: Final = 64_000_000  # bytes
LABELS: Final = ("setup", "run")
REQUIRED: Final = ("setup", "run", "order")
#: columns without a unit in their name
UNITLESS: Final = ("order", "direction", "repeat")
FEED_UNIT: Final = "mm_min"
MAX_COLUMNS: Final = 200  # columns
#: names in a frame that no column of a file can have
FILE, ROW = "#file", "#row"
HEADER: Final = (
    "the first line names the columns: setup,run,order, then a pose and a reading such"
    " as z_mm,length_mm"
)


class ReadingsError(ValueError):
    """Readings that cannot be used. `str()` is one paragraph: file, row, column, value,
    what to do.
    """

    def __init__(
        self,
        problem: str,
        remedy: str,
        *,
        file: str,
        row: int | None = None,
        column: str = "",
        value: str = "",
    ) -> None:
        self.problem, self.remedy, self.file, self.value = problem, remedy, file, value
        self.row, self.column = row, column
        self.where = ", ".join(
            ([f"row {row}"] if row else [])
            + ([f"column {_short(column)}"] if column else [])
        )
        subject = (
            f"{self.where} = {_short(value)}" if value and self.where else self.where
        )
        super().__init__(
            ": ".join(part for part in (file, subject, problem) if part)
            + f"; {remedy}."
        )


@dataclasses.dataclass(frozen=True, slots=True)
class ReadingsColumn:
    """A column of the file: its name, what it measures, and the factor to SI `unit`."""

    name: str
    stem: str
    unit: str
    factor: float


@dataclasses.dataclass(frozen=True)
class ReadingsFile:
    """Checked cells.

    frame    one row a row of the file: `setup`, `run` (text), `order` (int), and each
             further column by its stem, SI, NaN where the cell is empty; FILE and ROW
             tell where it stands
    columns  the file's columns by stem
    """

    file: str
    frame: pd.DataFrame
    columns: dict[str, ReadingsColumn]

    def error(self, problem: str, remedy: str, at: int, stem: str) -> ReadingsError:
        """The error to raise for row number `at` of the frame and a column by its stem."""
        row = self.frame.iloc[at]
        column = self.columns.get(stem)
        told, cell = (column.name, row[stem]) if column else (stem, "")
        value = cell / column.factor if column and isinstance(cell, float) else cell
        shown = (
            f"{value:.6g}"
            if isinstance(value, float) and np.isfinite(value)
            else ""
            if value != value
            else value
        )
        return ReadingsError(
            problem,
            remedy,
            file=str(row[FILE]),
            row=int(row[ROW]),
            column=told,
            value=str(shown),
        )


def read(path: Path, known: Mapping[str, str] | None = None) -> ReadingsFile:
    """Read and check one file. Raises ReadingsError for the first thing that is wrong,
    OSError if it is not there.

    `known` are names with SI units that the caller expects: they make the remedy for a
    wrong unit exact.
    """
    return from_rows(_cells(_text(path), str(path), known or {}), str(path), known)


def from_rows(
    rows: Sequence[tuple[int, Sequence[str]]],
    file: str,
    known: Mapping[str, str] | None = None,
) -> ReadingsFile:
    """A table from numbered rows of cells, the header first; otherwise as `read`."""
    columns = _header(rows[0][1], file, known or {})
    body = rows[1:]
    if not body:
        raise ReadingsError(
            "there are no readings below the header", "add one row a reading", file=file
        )
    text = {
        c.stem: [cells[k].strip() for _, cells in body]
        for k, c in enumerate(columns.values())
    }
    numbers = np.array([n for n, _ in body])
    frame = pd.DataFrame({FILE: file, ROW: numbers})
    for stem, column in columns.items():
        frame[stem] = (
            text[stem]
            if stem in LABELS
            else _numbers(column, text[stem], numbers, file)
        )
    table = ReadingsFile(file, frame, columns)
    _check_labels(table)
    return table


def parse_column(name: str) -> ReadingsColumn:
    """What a column's name says. Raises UnitError."""
    if name in LABELS or name in UNITLESS:
        return ReadingsColumn(name, name, "1", 1.0)
    stem, _, tail = name.partition("_")
    if stem == "feed" and tail == FEED_UNIT:
        return ReadingsColumn(
            name, stem, "m/s", units.factor("mm") / units.factor("min")
        )
    stem, unit = units.split(name)
    return ReadingsColumn(name, stem, units.si_unit(unit), units.factor(unit))


def suggest(word: str, known: Iterable[str]) -> str:
    """Remedy for an unknown name."""
    names = list(dict.fromkeys(known))
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    told = ", ".join(names[:24]) + (", ..." if len(names) > 24 else "")
    return (f"did you mean {near[0]}? " if near else "") + f"known: {told}"


def _text(path: Path) -> str:
    size = path.stat().st_size
    if not path.is_file():
        raise ReadingsError("this is no file", "name a readings file", file=str(path))
    if size > MAX_BYTES:
        problem = f"{size / 1e6:.0f} MB is too large for readings"
        raise ReadingsError(
            problem, f"split it: at most {MAX_BYTES / 1e6:.0f} MB", file=str(path)
        )
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        problem = f"the file is no UTF-8 text (byte {error.start + 1})"
        raise ReadingsError(
            problem, "save it as CSV in UTF-8", file=str(path)
        ) from None
    if not text.strip():
        raise ReadingsError("the file is empty", HEADER, file=str(path))
    if "\0" in text:
        raise ReadingsError(
            "the file holds NUL characters", "save it as CSV in UTF-8", file=str(path)
        )
    return text


def _cells(
    text: str, file: str, known: Mapping[str, str]
) -> list[tuple[int, list[str]]]:
    """Rows with their numbers; blank ones are left out, ragged ones refused."""
    rows: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for number, cells in enumerate(reader, start=1):
            if not any(c.strip() for c in cells):
                continue
            if not rows:
                _header(cells, file, known)
            elif len(cells) != len(rows[0][1]):
                problem = f"{len(cells)} cells, but the header has {len(rows[0][1])}"
                raise ReadingsError(
                    problem,
                    "give one cell a column, empty where there is none",
                    file=file,
                    row=number,
                )
            rows.append((number, cells))
    except csv.Error:
        problem = "the lines are no CSV"
        raise ReadingsError(problem, HEADER, file=file, row=len(rows) + 1) from None
    return rows


def _header(
    cells: Sequence[str], file: str, known: Mapping[str, str]
) -> dict[str, ReadingsColumn]:
    """Columns by stem, in order. Raises ReadingsError."""
    names = [c.strip() for c in cells]
    missing = [n for n in REQUIRED if n not in names]
    if missing and len(names) == 1 and ";" in names[0]:
        raise ReadingsError(
            "cells are separated by semicolons",
            "use commas, and points in numbers",
            file=file,
            row=1,
        )
    if missing:
        raise ReadingsError(
            f"the column {missing[0]} is missing",
            HEADER,
            file=file,
            row=1,
            column=missing[0],
        )
    if len(names) > MAX_COLUMNS:
        raise ReadingsError(
            f"{len(names)} columns are too many", HEADER, file=file, row=1
        )
    columns: dict[str, ReadingsColumn] = {}
    for name in names:
        try:
            column = parse_column(name)
        except units.UnitError:
            remedy = _with_unit(name, known)
            raise ReadingsError(
                "no known unit in the name",
                remedy,
                file=file,
                row=1,
                column=name or "?",
            ) from None
        if column.stem in columns:
            problem = f"{column.stem} is given twice"
            raise ReadingsError(
                problem,
                f"keep {columns[column.stem].name} or {name}",
                file=file,
                row=1,
                column=name,
            )
        columns[column.stem] = column
    return columns


def spellings(stem: str, unit: str) -> list[str]:
    """How a column of an SI unit may be written."""
    return [f"{stem}_{u}" for u in units.UNITS if units.si_unit(u) == unit]


def _with_unit(name: str, known: Mapping[str, str]) -> str:
    """Remedy for a column without a known unit."""
    stem = name.rpartition("_")[0]
    for found in (name, stem):
        if found in known:
            return f"write {', '.join(spellings(found, known[found]))}"
    plain = difflib.get_close_matches(name, (*UNITLESS, *LABELS), n=1, cutoff=0.7)
    return (
        f"did you mean {plain[0]}?"
        if plain
        else f"end it in a known unit: {', '.join(units.UNITS)}"
    )


def _numbers(
    column: ReadingsColumn, text: Sequence[str], rows: np.ndarray, file: str
) -> np.ndarray:
    """SI values of a column, NaN where the cell is empty."""
    cells = pd.Series(text, dtype=object)
    values = pd.to_numeric(cells, errors="coerce").to_numpy(
        dtype=float, na_value=np.nan
    )
    bad = np.flatnonzero((cells != "").to_numpy() & ~np.isfinite(values))
    if bad.size:
        k = int(bad[0])
        comma = "," in text[k]
        remedy = (
            "write decimals with a point"
            if comma
            else "leave the cell empty where no reading was taken"
        )
        raise ReadingsError(
            "not a finite number",
            remedy,
            file=file,
            row=int(rows[k]),
            column=column.name,
            value=text[k],
        )
    return np.asarray(values * column.factor)


def _check_labels(table: ReadingsFile) -> None:
    """Set-up and run named, order a whole number, direction +1 or -1."""
    frame = table.frame
    for stem in LABELS:
        for at in np.flatnonzero(frame[stem] == "")[:1]:
            raise table.error(
                "the cell is empty", f"name the {stem} of every row", int(at), stem
            )
    order = frame["order"].to_numpy()
    for at in np.flatnonzero(~(np.isfinite(order) & (order == np.round(order))))[:1]:
        raise table.error(
            "order is a whole number",
            "count the readings of a run in time: 1, 2, 3",
            int(at),
            "order",
        )
    if "direction" in frame:
        direction = frame["direction"].to_numpy()
        for at in np.flatnonzero(~(np.isnan(direction) | (np.abs(direction) == 1.0)))[
            :1
        ]:
            raise table.error(
                "direction is +1 or -1",
                "write 1 or -1, or leave it empty",
                int(at),
                "direction",
            )
    frame["order"] = order.astype(np.int64)


def _short(text: str, length: int = 40) -> str:
    line = " ".join(
        "".join(c if c.isprintable() else " " for c in text[: 4 * length]).split()
    )
    return line if len(line) <= length else line[: length - 4] + " ..."
