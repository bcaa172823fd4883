"""Checked cells of a readings file, and the error of one that cannot be used."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import pandas as pd

from oed.dataset.columns import (
    ReadingsColumn,
)
from oed.text import shorten

#: columns of a frame that no column of a file can have: the row's file and number
FILE, ROW = "#file", "#row"
#: characters of a name or value in an error
SHOWN: Final = 40


class ReadingsError(ValueError):
    """Readings that cannot be used; `str()` is file, row, column, value and remedy."""

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
        where = []
        if row:
            where.append(f"row {row}")
        if column:
            where.append(f"column {shorten(column, SHOWN)}")
        self.where = ", ".join(where)
        subject = self.where
        if value and subject:
            subject = f"{subject} = {shorten(value, SHOWN)}"
        message = ": ".join(part for part in (file, subject, problem) if part)
        super().__init__(f"{message}; {remedy}.")


@dataclasses.dataclass(frozen=True)
class ReadingsFile:
    """Checked cells of a readings file.

    file     path, for errors
    frame    one row a row of the file: `setup` and `run` (text), `order` (int), and
             each further column by its stem, SI, NaN where the cell is empty; FILE and
             ROW state where it is in which file
    columns  columns of the file, by stem
    """

    file: str
    frame: pd.DataFrame
    columns: dict[str, ReadingsColumn]

    def error(self, problem: str, remedy: str, at: int, stem: str) -> ReadingsError:
        """The error to raise for row `at` of the frame (from 0) and a column."""
        row = self.frame.iloc[at]
        name, value = stem, ""
        if stem in self.columns:
            column = self.columns[stem]
            name, value = column.name, _as_written(row[stem], column)
        return ReadingsError(
            problem,
            remedy,
            file=str(row[FILE]),
            row=int(row[ROW]),
            column=name,
            value=value,
        )


def _as_written(cell: object, column: ReadingsColumn) -> str:
    """A cell of the frame as it stands in the file; empty where it is not finite."""
    if not isinstance(cell, float):
        return str(cell)
    value = cell / column.factor
    return f"{value:.6g}" if math.isfinite(value) else ""
