"""A CSV file of another program: any separator, decimal commas, lines above the header.

The numbers start at the first line with as many cells as most lines have, at least half
of their filled cells numbers. The line above them with as many cells is the header, or else a comment
with as many names; without one, columns have the names 1, 2, 3. Facts above the header, as in `Feed,1500`, are no
readings, and a header that is repeated within the file is passed over.
"""

import collections
import contextlib
import csv
import dataclasses
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from oed.base import Array
from oed.text import suggest
from oed.units import UNITS
from pkm_studies import files
from pkm_studies.base import InputError

MAX_BYTES = 64_000_000  #: bytes of the largest file
SEPARATORS = (";", "\t", ",", "|")
COMMENTS = ("#", "//", "%", "!")
#: a number as machines and instruments write it: not all that Python takes for one
PLAIN = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")

Line = tuple[int, list[str]]  #: number of a line in its file, and its cells


@dataclasses.dataclass(frozen=True)
class CsvTable:
    """Cells of a CSV file."""

    file: str  #: path, for errors
    header: tuple[str, ...]  #: names of the columns
    lines: tuple[Line, ...]  #: numbered lines of cells, as many each as the header has
    #: numbered lines above the header: facts of the whole file
    above: tuple[Line, ...] = ()

    def __len__(self) -> int:
        return len(self.lines)

    def error(self, k: int, name: str, problem: str, remedy: str) -> InputError:
        """The error to raise for line k (from 0) of the table and a column."""
        number, cells = self.lines[k]
        field = f"line {number}, column {name}"
        value = cells[self._index(name)]
        return InputError(problem, remedy, file=self.file, field=field, value=value)

    def cells(self, name: str) -> list[str]:
        """Text of a column. Raises InputError for a column that is not there."""
        column = self._index(name)
        return [cells[column] for _, cells in self.lines]

    def numbers(self, name: str, *, gaps: bool = False) -> Array:
        """Values (n,) of a column; with `gaps`, NaN for empty cells. Raises InputError."""
        values = np.full(len(self), np.nan)
        for k, cell in enumerate(self.cells(name)):
            if gaps and not cell:
                continue
            value = _number(cell)
            if value is None:
                remedy = "correct the cell, or leave its line out"
                raise self.error(k, name, "not a finite number", remedy)
            values[k] = value
        return values

    def _index(self, name: str) -> int:
        if name not in self.header:
            remedy = suggest(name, self.header, "columns are")
            problem = "no such column"
            raise InputError(
                problem, remedy, file=self.file, field="header", value=name
            )
        return self.header.index(name)


def read(path: Path) -> CsvTable:
    """The table of a file. Raises InputError with line and remedy."""
    text = files.read_text(path, limit=MAX_BYTES, what="CSV file", is_foreign=True)
    written = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]
    with named_errors(str(path)):
        lines, width = _split(written)
    start = _first_numbers(lines, width, str(path))
    header = _header(lines[:start], width, str(path))
    if header == _numbered(width):
        header = _commented_header(text, width) or header
    headings = {tuple(cells) for _, cells in lines[:start] if not _has_numbers(cells)}
    below = [line for line in lines[start:] if tuple(line[1]) not in headings]
    return CsvTable(
        file=str(path),
        header=header,
        lines=tuple(_body(below, width, str(path))),
        above=tuple(lines[:start]),
    )


@contextlib.contextmanager
def named_errors(file: str) -> Iterator[None]:
    """InputError, with the file, where Python's reader of CSV gives up."""
    try:
        yield
    except csv.Error as error:
        raise InputError(
            f"this is no CSV: {error}", "check its cells", file=file
        ) from None


def _split(written: Sequence[tuple[int, str]]) -> tuple[list[Line], int]:
    """Lines of cells at the separator that most lines agree on, and their width."""
    best: tuple[int, list[Line], int] = (0, [], 0)
    for separator in SEPARATORS:
        reader = csv.reader((line for _, line in written), delimiter=separator)
        numbers = (number for number, _ in written)
        lines = [
            (number, [cell.strip() for cell in cells])
            for number, cells in zip(numbers, reader, strict=False)
        ]
        best = max(best, _agreement(lines), key=lambda entry: entry[0])
    if best[2] < 2:  # columns of blanks
        best = _agreement([(number, line.split()) for number, line in written])
    return best[1], best[2]


def _agreement(lines: list[Line]) -> tuple[int, list[Line], int]:
    """How many lines have the commonest number of cells, two at least; the lines."""
    counts = collections.Counter(len(cells) for _, cells in lines)
    width, number = max(counts.items(), key=lambda entry: entry[1], default=(0, 0))
    return (number if width > 1 else 0), lines, width


def _first_numbers(lines: Sequence[Line], width: int, file: str) -> int:
    """Index of the first line of numbers. Raises InputError."""
    wide = {k: cells for k, (_, cells) in enumerate(lines) if len(cells) == width}
    counts = {k: sum(map(_is_number, cells)) for k, cells in wide.items()}
    numeric = [k for k, cells in wide.items() if _has_numbers(cells)]
    if not numeric:
        problem = "no line of numbers in columns"
        raise InputError(problem, "give a CSV with one reading a line", file=file)
    usual = [
        column
        for column, cells in enumerate(zip(*[wide[k] for k in numeric], strict=True))
        if 2 * sum(map(_is_number, cells)) > len(cells)
    ]
    cells = {k: [wide[k][column] for column in usual] for k in numeric}
    # a fact above the header, such as a rate of 100 alone, leaves most columns empty
    full = [k for k in numeric if 2 * sum(map(bool, cells[k])) > len(usual)] or numeric
    plain = (k for k in full if all(not c or _is_number(c) for c in cells[k]))
    first = next(plain, numeric[0])
    # Text in a column of numbers is a fact above the header, or a mistake to refuse.
    above_header = any(counts.get(k) == 0 for k in range(numeric[0], first))
    return first if above_header else numeric[0]


def _has_numbers(cells: Sequence[str]) -> bool:
    """Whether half of the filled cells of a line are numbers, or more."""
    numbers = sum(map(_is_number, cells))
    return 0 < sum(map(bool, cells)) <= 2 * numbers


def _is_number(cell: str) -> bool:
    return _number(cell) is not None


def _header(above: Sequence[Line], width: int, file: str) -> tuple[str, ...]:
    """Names of the columns, from the nearest lines above the numbers that fit.

    A line of units goes to the names above it. Names that repeat have the words of the
    lines above before them: motion capture writes Position over X.
    """
    fitting = [
        (number, cells)
        for number, cells in reversed(above)
        if len(cells) == width and any(cells)
    ]
    if not fitting:
        return _numbered(width)
    (number, names), *higher = fitting
    if higher and any(names) and all(_unit(cell) in UNITS for cell in names if cell):
        units, names = names, higher.pop(0)[1]
        names = [
            f"{name} [{_unit(unit)}]" if unit else name
            for name, unit in zip(names, units, strict=True)
        ]
    while higher and _repeated(names):
        last = ""
        labels = [last := label or last for label in higher.pop(0)[1]]
        names = [f"{w} {name}".strip() for w, name in zip(labels, names, strict=True)]
    repeated = _repeated(names)
    if repeated:
        problem, remedy = "two columns of this name", "rename one of them"
        field = f"line {number}"
        raise InputError(problem, remedy, file=file, field=field, value=repeated[0])
    return tuple(name or str(k) for k, name in enumerate(names, start=1))


def _unit(cell: str) -> str:
    return cell.strip("[]() ")


def _repeated(names: Sequence[str]) -> list[str]:
    """Names, not empty, that stand over several columns."""
    counts = collections.Counter(filter(None, names))
    return [name for name, count in counts.items() if count > 1]


def _numbered(width: int) -> tuple[str, ...]:
    """Names of columns without a header."""
    return tuple(str(k) for k in range(1, width + 1))


def _commented_header(text: str, width: int) -> tuple[str, ...]:
    """Names of the columns in the last comment that has one for each; () without."""
    for line in reversed(text.splitlines()):
        if not line.lstrip().startswith(COMMENTS):
            continue
        names = line.strip().lstrip("".join(COMMENTS))
        for separator in SEPARATORS:
            cells = tuple(cell.strip() for cell in names.split(separator))
            distinct = len(set(cells)) == width == len(cells) and all(cells)
            if distinct and not any(map(_is_number, cells)):
                return cells
    return ()


def _body(lines: Sequence[Line], width: int, file: str) -> list[Line]:
    for number, cells in lines:
        if len(cells) != width:
            raise InputError(
                f"{len(cells)} cells, but the lines above have {width}",
                "give every line as many cells, and points or commas in all decimals",
                file=file,
                field=f"line {number}",
            )
    return list(lines)


def _number(cell: str) -> float | None:
    """A finite number, with a point or a comma; None for other text."""
    text = cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell
    value = plain_number(text)
    return value if value is not None and math.isfinite(value) else None


def plain_number(text: str) -> float | None:
    """The value of a decimal number; None for other text.

    Underscores, digits of other scripts, `nan` and `inf` are none. The value may be
    infinite where the exponent is.
    """
    stripped = text.strip()
    return float(stripped) if PLAIN.fullmatch(stripped) else None
