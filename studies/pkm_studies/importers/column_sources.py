"""Where a readings column comes from: a column of a CSV, times a factor, plus an offset.

A name with braces stands for several columns: `"read_{x,y}_mm" = "X{1,2}"` is read_x_mm
of X1 and read_y_mm of X2. Factors and offsets may then be lists, one number a column.
"""

import re
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed.base import Array
from oed.dataset import SIGMA, UNITLESS
from pkm_studies.base import Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers.map_tables import ColumnMap, ColumnSource

BRACES = re.compile(r"\{([^{}]*)\}")
DECIMALS = re.compile(r"[.,](\d+)$")
PRODUCT_DIGITS = 14  #: significant digits of a product: less is rounding


def expanded(mapping: ColumnMap, location: Location) -> ColumnMap:
    """The map with one entry a column, plain ones as their name. Raises InputError."""
    columns: dict[str, str | ColumnSource] = {}
    for name, entry in mapping.columns.items():
        field = location.path("columns", name)
        for single, source in _singles(name, source_of(entry), field):
            if single in columns:
                raise field.error(f"{single} is given twice", "remove one of the two")
            _check(single, source, field)
            is_plain = source == ColumnSource(column=source.column)
            columns[single] = source.column if is_plain else source
    return msgspec.structs.replace(mapping, columns=columns)


def source_of(entry: str | ColumnSource) -> ColumnSource:
    """The source of an entry of a map, which may be a column's name alone."""
    return ColumnSource(column=entry) if isinstance(entry, str) else entry


def names(columns: Mapping[str, str | ColumnSource]) -> dict[str, str]:
    """Column of the CSV by column of the readings."""
    return {name: source_of(entry).column for name, entry in columns.items()}


def values(entry: str | ColumnSource, table: CsvTable) -> Array:
    """Numbers (n,) of a column of the readings; NaN where the cell is empty."""
    source = source_of(entry)
    cells = table.numbers(source.column, gaps=True)
    factor, offset = _number(source.factor), _number(source.offset)
    if (factor, offset, source.k) == (1.0, 0.0, None):
        return cells
    scaled = factor * cells / (source.k or 1.0) + offset
    return np.array([float(f"{value:.{PRODUCT_DIGITS}g}") for value in scaled])


def least_spread(entry: str | ColumnSource, table: CsvTable) -> float:
    """What a standard deviation of 0 is at most: half the last digit of its column.

    0 where that is no rounding: of whole numbers, and of a column of nothing but 0.
    """
    source = source_of(entry)
    decimals = map(DECIMALS.search, table.cells(source.column))
    digits = max((len(match[1]) for match in decimals if match), default=0)
    if not digits or not values(entry, table).any():
        return 0.0
    return 0.5 * 10.0**-digits * abs(_number(source.factor)) / (source.k or 1.0)


def sentence(name: str, entry: str | ColumnSource) -> str:
    """What was taken for a column, in words."""
    source = source_of(entry)
    phrases = [source.column]
    if source.factor != 1.0:
        phrases.append(f"times {_number(source.factor):.9g}")
    if source.k is not None:
        phrases.append(f"over k = {source.k:g}")
    if source.offset != 0.0:
        phrases.append(f"plus {_number(source.offset):.9g}")
    return f"{' '.join(phrases)} as {name}"


def _singles(
    name: str, source: ColumnSource, field: Location
) -> Sequence[tuple[str, ColumnSource]]:
    """An entry with braces as single ones. Raises InputError."""
    parts, others = _parts(name, field), _parts(source.column, field)
    if len(parts) != len(others):
        problem = f"{len(parts)} columns of readings, {len(others)} of the file"
        raise field.error(problem, "list as many in both braces", source.column)
    factors = _list(source.factor, len(parts), field.key("factor"))
    offsets = _list(source.offset, len(parts), field.key("offset"))
    return [
        (part, ColumnSource(column=other, factor=factor, offset=offset, k=source.k))
        for part, other, factor, offset in zip(
            parts, others, factors, offsets, strict=True
        )
    ]


def _parts(text: str, field: Location) -> list[str]:
    """The names that a name with braces stands for. Raises InputError."""
    pairs = BRACES.findall(text)
    if not pairs:
        return [text]
    if len(pairs) > 1:
        raise field.error("two pairs of braces", "write one", text)
    choices = [choice.strip() for choice in pairs[0].split(",")]
    return [BRACES.sub(lambda _, c=choice: c, text) for choice in choices]  # type: ignore[misc]


def _list(value: float | list[float], count: int, field: Location) -> list[float]:
    numbers = value if isinstance(value, list) else [value] * count
    if len(numbers) != count:
        problem = f"{len(numbers)} numbers for {count} columns"
        raise field.error(problem, "give one number, or one a column")
    return numbers


def _number(value: float | list[float]) -> float:
    return value[0] if isinstance(value, list) else value


def _check(name: str, source: ColumnSource, field: Location) -> None:
    """Raises InputError for a factor that leaves nothing, and for k of no spread."""
    is_spread = name.startswith(SIGMA)
    if source.factor == 0.0:
        raise field.key("factor").error(
            "a factor of 0 leaves nothing", "correct it", 0.0
        )
    if source.k is not None and not is_spread:
        raise field.key("k").error(
            "k is the coverage factor of an uncertainty",
            f"give it to a column {SIGMA}...",
            source.k,
        )
    if is_spread and source.offset != 0.0:
        problem = "a standard deviation has no offset"
        raise field.key("offset").error(problem, "remove it", _number(source.offset))
    is_text = name in UNITLESS
    if is_text and source != ColumnSource(column=source.column):
        raise field.error(f"{name} has no unit", "give the column's name alone")
