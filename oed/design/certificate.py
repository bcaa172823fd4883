"""Certificates: upper bounds that hold by convexity at any feasible dual point, never
on a solver's word.

log det is concave, so for every positive definite M and every plan w' with information
M' = M0 + sum w'_i A_i,

    log det M' <= log det M + tr(M^-1 M0) + sum_i w'_i tr(M^-1 A_i) - n,

and the sum is at most what the best slopes carry. M need not come from a feasible plan,
nor from a converged one: the bound only gets looser. Homogeneous criteria have tighter
lines through the origin (`oed.design.criterion.protocol`). The error left is the
rounding of one factorisation, added on the safe side.
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array

#: rounding of one factorisation, in log phi
SAFE = 1e-12


def carried(slopes: Array, size: float, cap: Array | float) -> float:
    """max sum_i w_i slopes_i over 0 <= w_i <= cap_i, sum w = size: the best candidates,
    filled to their caps.
    """
    if np.ndim(cap):
        caps = np.asarray(cap, dtype=float)
        order = np.argsort(-slopes, kind="stable")
        left = size - np.concatenate([[0.0], np.cumsum(caps[order])[:-1]])
        return float(slopes[order] @ np.clip(left, 0.0, caps[order]))
    cap = float(cap)
    if not np.isfinite(cap) or cap >= size:
        return float(size * slopes.max())
    whole = int(size // cap)
    best = np.partition(slopes, len(slopes) - min(whole + 1, len(slopes)))[::-1]
    best = np.sort(best[: whole + 1])[::-1]
    rest = size - cap * whole
    return float(cap * best[:whole].sum() + (rest * best[whole] if rest > 0 else 0.0))
