"""Numbers of a result that may be missing: None and NaN alike become NaN."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from oed.base import Array


def or_nan(value: float | None) -> float:
    """The number as a float; NaN where there is none."""
    return math.nan if value is None else float(value)


def entry(numbers: Mapping[str, float | None], key: str) -> float:
    """The number of a key; NaN where the key is missing."""
    return or_nan(numbers.get(key))


def column(rows: Iterable[Mapping[str, float | None]], key: str) -> Array:
    """The number of a key in each row (n,); NaN where it is missing."""
    return np.array([entry(row, key) for row in rows], dtype=float)


def array(values: Sequence[float | None]) -> Array:
    """Numbers as floats (n,); NaN where one is missing."""
    return np.array([or_nan(value) for value in values], dtype=float)


def table(rows: Sequence[Sequence[float | None]]) -> Array:
    """Rows of equal length as floats (m, n); NaN where a number is missing."""
    if not rows:
        return np.zeros((0, 0))
    return np.array([array(row) for row in rows])


def finite(values: Iterable[float | None]) -> list[float]:
    """The finite numbers, in order."""
    return [x for x in map(or_nan, values) if math.isfinite(x)]
