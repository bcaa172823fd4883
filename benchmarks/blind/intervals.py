"""Intervals and paired tests of the benchmark's counts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

LEVEL = 0.95


def wilson(hits: int, count: int, level: float = LEVEL) -> tuple[float, float]:
    """Wilson's interval of a share (Wilson 1927, JASA 22, 209-212); (0, 1) without any
    case.
    """
    if not 0 <= hits <= count:
        raise ValueError(f"{hits} hits in {count} cases: give 0 <= hits <= count")
    if count == 0:
        return 0.0, 1.0
    z = float(stats.norm.isf((1.0 - level) / 2.0))
    share = hits / count
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = (
        z
        / (1 + z**2 / count)
        * math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    )
    # at either end the bound is the end itself, whatever rounding makes of it
    return (0.0 if hits == 0 else middle - half), (
        1.0 if hits == count else middle + half
    )


def mean(values: Sequence[float], level: float = LEVEL) -> tuple[float, float, float]:
    """Mean and its interval by Student's t; NaN without values, an endless interval for
    one alone.
    """
    told = np.asarray(values, dtype=float)
    if not told.size:
        return math.nan, math.nan, math.nan
    middle = float(told.mean())
    if told.size == 1:
        return middle, -math.inf, math.inf
    half = float(
        stats.t.isf((1.0 - level) / 2.0, told.size - 1)
        * told.std(ddof=1)
        / math.sqrt(told.size)
    )
    return middle, middle - half, middle + half


def median(values: Sequence[float], level: float = LEVEL) -> tuple[float, float, float]:
    """Median and its distribution-free interval by order statistics, which may be
    endless; NaN without values.
    """
    told = np.sort(np.asarray(values, dtype=float))
    if not told.size:
        return math.nan, math.nan, math.nan
    # r the largest with P(B < r) <= (1 - level) / 2, B binomial (n, 1/2): the interval
    # is [x_r, x_(n + 1 - r)]
    r = int(stats.binom.ppf((1.0 - level) / 2.0, told.size, 0.5))
    middle = float(np.median(told))
    if r < 1:
        return middle, -math.inf, math.inf
    return middle, float(told[r - 1]), float(told[-r])


def mcnemar(first: int, second: int) -> float:
    """Exact two-sided p-value of McNemar's test: cases that only the first, only the
    second of two methods gets.
    """
    if min(first, second) < 0:
        raise ValueError(f"{first} and {second} cases: give counts >= 0")
    if first + second == 0:
        return 1.0
    return float(stats.binomtest(first, first + second, 0.5).pvalue)
