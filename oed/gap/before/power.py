"""Power of a test that finds a gap: the noncentral chi-square."""

from __future__ import annotations

import functools

from scipy import optimize

#: false alarm and power that "is found" stands for
FALSE_ALARM, POWER = 0.01, 0.90


def power(lam: float, columns: int) -> float:
    """Probability that a test with `columns` degrees of freedom finds a gap of lambda."""
    from scipy import stats  # takes half a second to import

    level = stats.chi2.isf(FALSE_ALARM, columns)
    return float(stats.ncx2.sf(level, columns, lam))


@functools.cache
def needed_lambda(columns: int) -> float:
    """Least lambda that a test with `columns` degrees of freedom finds with `POWER`.

    It is 14.9 for 1 degree of freedom, 28.6 for 12.
    """

    def excess(lam: float) -> float:
        return power(lam, columns) - POWER

    return float(optimize.brentq(excess, 1e-6, 1e4))
