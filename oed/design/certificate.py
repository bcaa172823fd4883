"""Certificates: upper bounds that hold by convexity at any feasible dual point, never on a solver's word.

log det is concave, so for every positive definite M and every plan w' with information M' = M0 + sum w'_i A_i,

    log det M' <= log det M + tr(M^-1 M0) + sum_i w'_i tr(M^-1 A_i) - n,

and the sum is at most what the N best slopes carry. M need not come from a feasible plan, nor from a converged one:
the bound only gets looser. The error left is the rounding of one factorisation, added on the safe side.
"""

from __future__ import annotations

import numpy as np

from oed.batch import Array


def d_bound(m: Array, prior: Array, slopes: Array, size: float, cap: float) -> float:
    """Bound of log det over 0 <= w <= cap, sum w = size, from any positive definite m (n, n).

    slopes (C,): tr(m^-1 A_i) of every candidate.
    """
    n = m.shape[0]
    value = float(np.linalg.slogdet(m)[1])
    held = float(np.trace(np.linalg.solve(m, prior)))
    reached = value + held + carried(slopes, size, cap) - n
    return float(reached + 1e-13 * (abs(value) + n) * n)


def e_bound(dual: Array, prior: Array, values: Array, size: float, cap: float) -> float:
    """Bound of the least eigenvalue, from any positive semidefinite `dual` (n, n) of trace 1.

    lambda_min(M') <= tr(Z M') = tr(Z M0) + sum_i w'_i tr(Z A_i); values (C,): tr(Z A_i) of every candidate.
    """
    return float(np.trace(dual @ prior)) + carried(values, size, cap) * (1.0 + 1e-13)


def carried(slopes: Array, size: float, cap: float) -> float:
    """max sum_i w_i slopes_i over 0 <= w <= cap, sum w = size."""
    if not np.isfinite(cap) or cap >= size:
        return float(size * slopes.max())
    whole = int(size // cap)
    best = np.partition(slopes, len(slopes) - min(whole + 1, len(slopes)))[::-1]
    best = np.sort(best[: whole + 1])[::-1]
    rest = size - cap * whole
    return float(cap * best[:whole].sum() + (rest * best[whole] if rest > 0 else 0.0))


def d_efficiency(value: float, bound: float, directions: int) -> float:
    """exp((value - bound) / n): share of the information a direction that the best plan could have, at least."""
    return float(np.exp((value - bound) / directions))
