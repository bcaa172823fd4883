"""Power of a test that finds a gap: the noncentral chi-square."""

from __future__ import annotations

import functools

import numpy as np
from scipy import optimize, stats

#: false alarm and power that "is found" stands for
FALSE_ALARM, POWER = 0.01, 0.90


@functools.cache
def needed_lambda(
    columns: int,
    false_alarm: float = FALSE_ALARM,
    power: float = POWER,
) -> float:
    """Least lambda that a test with `columns` degrees of freedom finds with that power.

    It is 14.9 for 1 degree of freedom, 28.6 for 12.
    """
    level = stats.chi2.isf(false_alarm, columns)

    def excess(lam: float) -> float:
        return float(stats.ncx2.sf(level, columns, lam) - power)

    return float(optimize.brentq(excess, 1e-6, 1e4))


def ideal_power(
    lam: float,
    columns: int,
    alternatives: int = 1,
    false_alarm: float = FALSE_ALARM,
) -> float:
    """Probability that the best of `alternatives` tests finds a gap of `lam`.

    `false_alarm` is that of all tests together.
    """
    single = -np.expm1(np.log1p(-false_alarm) / alternatives)
    level = stats.chi2.isf(single, columns)
    return float(stats.ncx2.sf(level, columns, lam))
