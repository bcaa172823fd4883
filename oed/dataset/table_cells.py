"""Cells of a table in columns, from rows of text, converted block by block.

Text cells take some forty bytes each, however short they are; numbers take eight.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from oed import csv_text
from oed.base import Array, Index
from oed.dataset.columns import LABELS, ReadingsColumn
from oed.dataset.dialect import Row
from oed.dataset.readings_file import ReadingsError

#: rows whose cells are in memory as text at once
BLOCK: Final = 10_000
#: size of a number in a cell beyond which it is a slip
LARGEST: Final = 1e12

#: SI values (n,) of cells of a column, by its stem, with the numbers (n,) of their rows
Convert = Callable[[str, Sequence[str], Index], Array]


@dataclasses.dataclass(frozen=True, slots=True)
class TableCells:
    """Cells of a table.

    rows     number (n,) of each row in its file
    columns  by stem: labels, or SI values (n,), NaN where a cell is empty
    """

    rows: Index
    columns: Mapping[str, Sequence[str] | Array]


def by_column(
    rows: Iterable[Row], places: Mapping[str, int], convert: Convert
) -> TableCells:
    """Columns of numbered rows of cells; `places` are those of stems in a row.

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
    return TableCells(every, {stem: (labels | values)[stem] for stem in places})


def _blocks(rows: Iterable[Row]) -> Iterator[list[Row]]:
    remaining = iter(rows)
    while block := list(itertools.islice(remaining, BLOCK)):
        yield block


def numbers_of(
    column: ReadingsColumn,
    text: Sequence[str],
    rows: Index,
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
