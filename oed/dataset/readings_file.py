"""Checked cells of a readings file, and the error of one that cannot be used."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

from oed.dataset.columns import ReadingsColumn
from oed.text import shorten

if TYPE_CHECKING:
    import pandas as pd

#: column of a frame, which no file can have: the row's file
FILE = "#file"
#: column of a frame, which no file can have: the row's number in its file
ROW = "#row"
MAX_SHOWN: Final = 40  #: characters of a name or value in an error


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
            where.append(f"column {shorten(column, MAX_SHOWN)}")
        self.where = ", ".join(where)
        subject = self.where
        if value and subject:
            subject = f"{subject} = {shorten(value, MAX_SHOWN)}"
        message = ": ".join(part for part in (file, subject, problem) if part)
        super().__init__(f"{message}; {remedy}.")


@dataclasses.dataclass(frozen=True)
class ReadingsFile:
    """Checked cells of a readings file."""

    file: str  #: path, for errors
    #: one row a row of the file: `setup` and `run` (text), `order` (int), and each
    #: further column by its stem, SI, NaN where the cell is empty; FILE and ROW state
    #: where it is in which file
    frame: pd.DataFrame
    columns: dict[str, ReadingsColumn]  #: columns of the file, by stem

    def error(self, problem: str, remedy: str, index: int, stem: str) -> ReadingsError:
        """The error to raise for row `index` of the frame (from 0) and a column."""
        row = self.frame.iloc[index]
        name = stem
        value = ""
        if stem in self.columns:
            column = self.columns[stem]
            name = column.name
            value = _written_cell(row[stem], column)
        return ReadingsError(
            problem,
            remedy,
            file=str(row[FILE]),
            row=int(row[ROW]),
            column=name,
            value=value,
        )


def _written_cell(cell: object, column: ReadingsColumn) -> str:
    """A cell of the frame as it stands in the file; empty where it is not finite."""
    if not isinstance(cell, float):
        return str(cell)
    value = cell / column.factor
    return f"{value:.6g}" if math.isfinite(value) else ""
