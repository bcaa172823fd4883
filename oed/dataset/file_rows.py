"""Rows of readings files: a number, and the file where there are several."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd

from oed.base import Array

#: column of the covariates that states the file of each reading, where there are several
FILE_COLUMN = "file"


@dataclasses.dataclass(frozen=True, order=True, slots=True)
class FileRow:
    """A row of one of several files, in their order; as text it names the file."""

    place: int
    row: int
    file: str

    def __int__(self) -> int:
        return self.row

    def __str__(self) -> str:
        return f"{self.row} of {self.file}"


#: a row of the only file, or of one of several
Row = int | FileRow


def named_rows(covariates: pd.DataFrame) -> Array:
    """The row (n,) of each reading, with its file where covariates state several."""
    rows = covariates["row"].to_numpy()
    if FILE_COLUMN not in covariates:
        return np.asarray(rows)
    files = pd.Categorical(covariates[FILE_COLUMN])
    named = [
        FileRow(int(place), int(row), str(file))
        for place, row, file in zip(files.codes, rows, files, strict=True)
    ]
    return np.array(named, dtype=object)


def file_of(row: Row) -> str:
    """The file of a row; empty for the only one."""
    return row.file if isinstance(row, FileRow) else ""


def short_names(files: Sequence[str]) -> list[str]:
    """The files' names without their folders, where these differ."""
    names = [file.replace("\\", "/").rpartition("/")[2] for file in files]
    return names if len({*names}) == len(files) else list(files)
