"""Upper bounds that hold by convexity at any dual point, whatever a solver reports.

log det is concave. So for every positive definite M and every plan w' with information
M' = M0 + sum_i w'_i A_i,

    log det M' <= log det M + tr(M^-1 M0) + sum_i w'_i tr(M^-1 A_i) - n,

and the sum is at most the knapsack value of the slopes tr(M^-1 A_i). M need not belong
to a feasible or a converged plan: the bound only gets looser. Homogeneous criteria have
tighter lines through the origin (`oed.design.forms.protocol`). What rounding can
change is added on the safe side: of the slopes (`oed.design.objective`), of their sum,
and of the line's logarithms.
"""

from __future__ import annotations

import numpy as np

from oed.base import Array

#: allowance for the rounding of a line's logarithms, in log phi
ROUNDING = 1e-12


def knapsack_value(slopes: Array, size: float, cap: Array | float) -> float:
    """max sum_i w_i slopes_i over 0 <= w_i <= cap_i, sum_i w_i = size.

    The fractional knapsack: the best candidates are filled to their caps. slopes (C,);
    cap (C,), or one number for all.
    """
    if np.ndim(cap):
        caps = np.asarray(cap, dtype=float)
        order = np.argsort(-slopes, kind="stable")
        before = np.concatenate([[0.0], np.cumsum(caps[order])[:-1]])
        return float(slopes[order] @ np.clip(size - before, 0.0, caps[order]))
    cap = float(cap)
    if not np.isfinite(cap) or cap >= size:
        return float(size * slopes.max())
    full = int(size // cap)
    first = len(slopes) - min(full + 1, len(slopes))
    best = np.partition(slopes, first)[::-1]
    best = np.sort(best[: full + 1])[::-1]
    remainder = size - cap * full
    partial = remainder * best[full] if remainder > 0 else 0.0
    return float(cap * best[:full].sum() + partial)
