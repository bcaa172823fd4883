"""Intervals and paired tests of the benchmark's counts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

LEVEL = 0.95


def wilson(hits: int, count: int, level: float = LEVEL) -> tuple[float, float]:
    """Wilson's interval of a share (Wilson 1927, JASA 22, 209-212).

    (0, 1) without any case.
    """
    if not 0 <= hits <= count:
        raise ValueError(f"{hits} hits in {count} cases: give 0 <= hits <= count")
    if count == 0:
        return 0.0, 1.0
    z = float(stats.norm.isf((1.0 - level) / 2.0))
    share = hits / count
    norm = 1 + z**2 / count
    middle = (share + z**2 / (2 * count)) / norm
    variance = share * (1 - share) / count + z**2 / (4 * count**2)
    half = z / norm * math.sqrt(variance)
    # at either end the bound is the end itself, whatever rounding makes of it
    low = 0.0 if hits == 0 else middle - half
    high = 1.0 if hits == count else middle + half
    return low, high


def mean(values: Sequence[float], level: float = LEVEL) -> tuple[float, float, float]:
    """Mean and its interval by Student's t.

    NaN without values, an infinite interval for a single one.
    """
    numbers = np.asarray(values, dtype=float)
    if not numbers.size:
        return math.nan, math.nan, math.nan
    middle = float(numbers.mean())
    if numbers.size == 1:
        return middle, -math.inf, math.inf
    quantile = stats.t.isf((1.0 - level) / 2.0, numbers.size - 1)
    half = float(quantile * numbers.std(ddof=1) / math.sqrt(numbers.size))
    return middle, middle - half, middle + half


def median(values: Sequence[float], level: float = LEVEL) -> tuple[float, float, float]:
    """Median and its distribution-free interval by order statistics.

    NaN without values; the interval may be infinite.
    """
    numbers = np.sort(np.asarray(values, dtype=float))
    if not numbers.size:
        return math.nan, math.nan, math.nan
    # r the largest with P(B < r) <= (1 - level) / 2, B binomial (n, 1/2): the interval
    # is [x_r, x_(n + 1 - r)]
    r = int(stats.binom.ppf((1.0 - level) / 2.0, numbers.size, 0.5))
    middle = float(np.median(numbers))
    if r < 1:
        return middle, -math.inf, math.inf
    return middle, float(numbers[r - 1]), float(numbers[-r])


def mcnemar(first: int, second: int) -> float:
    """Exact two-sided p-value of McNemar's test.

    `first` and `second` are the cases that only one of two methods gets right.
    """
    if min(first, second) < 0:
        raise ValueError(f"{first} and {second} cases: give counts >= 0")
    if first + second == 0:
        return 1.0
    return float(stats.binomtest(first, first + second, 0.5).pvalue)
