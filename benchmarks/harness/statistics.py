"""Measures over cases with 95 % intervals."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

TAIL = 0.025  #: probability on either side of an interval of 95 %


@dataclasses.dataclass(frozen=True)
class Measure:
    """A measure over `count` cases: its title, value and interval."""

    title: str
    value: float
    low: float
    high: float
    count: int

    @property
    def cell(self) -> str:
        """The measure with its interval and number of cases."""
        if math.isnan(self.value):
            return "-"
        interval = f"{self.low:.2f} to {self.high:.2f}"
        return f"{self.value:.2f} ({interval}), n {self.count}"


def share(title: str, tests: Sequence[bool]) -> Measure:
    """A share of cases with Wilson's interval."""
    hits, count = sum(tests), len(tests)
    value = hits / count if count else math.nan
    return Measure(title, value, *wilson(hits, count), count)


def middle(title: str, values: Sequence[float]) -> Measure:
    """A median with its distribution-free interval."""
    return Measure(title, *median(values), len(values))


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's interval of a share (Wilson 1927, JASA 22, 209-212).

    (0, 1) without any case.
    """
    if not 0 <= hits <= count:
        raise ValueError(f"{hits} hits in {count} cases: give 0 <= hits <= count")
    if count == 0:
        return 0.0, 1.0
    z = float(stats.norm.isf(TAIL))
    share_of = hits / count
    norm = 1 + z**2 / count
    centre = (share_of + z**2 / (2 * count)) / norm
    variance = share_of * (1 - share_of) / count + z**2 / (4 * count**2)
    half = z / norm * math.sqrt(variance)
    # at either end the bound is the end itself, whatever rounding makes of it
    low = 0.0 if hits == 0 else centre - half
    high = 1.0 if hits == count else centre + half
    return low, high


def mean(values: Sequence[float]) -> tuple[float, float, float]:
    """Mean and its interval by Student's t.

    NaN without values, an infinite interval for a single one.
    """
    numbers = np.asarray(values, dtype=float)
    if not numbers.size:
        return math.nan, math.nan, math.nan
    centre = float(numbers.mean())
    if numbers.size == 1:
        return centre, -math.inf, math.inf
    quantile = stats.t.isf(TAIL, numbers.size - 1)
    half = float(quantile * numbers.std(ddof=1) / math.sqrt(numbers.size))
    return centre, centre - half, centre + half


def half_width(values: Sequence[float]) -> float:
    """Half of the 95 % interval of a mean, by Student's t."""
    centre, _, high = mean(values)
    return high - centre


def median(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and its distribution-free interval by order statistics.

    NaN without values; the interval may be infinite.
    """
    numbers = np.sort(np.asarray(values, dtype=float))
    if not numbers.size:
        return math.nan, math.nan, math.nan
    # r the largest with P(B < r) <= TAIL, B binomial (n, 1/2): the interval
    # is [x_r, x_(n + 1 - r)]
    r = int(stats.binom.ppf(TAIL, numbers.size, 0.5))
    centre = float(np.median(numbers))
    if r < 1:
        return centre, -math.inf, math.inf
    return centre, float(numbers[r - 1]), float(numbers[-r])
