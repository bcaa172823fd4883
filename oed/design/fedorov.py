"""D exchange of single rows by Fedorov's formula: all pairs at once.

Replacing i by j multiplies det M by (1 - d_ii)(1 + d_jj) + d_ij^2, d_ij = x_i^T M^-1
x_j (Fedorov 1972).
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array, Index

#: relative gain below which an exchange counts as none
GAIN = 1e-9


def improve(rows: Array, chosen: Index, base: Array) -> Index:
    """The best pair of rows (C, n) each time, until none helps; base (n, n) positive
    information held.
    """
    chosen = chosen.copy()
    inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    for count in range(100 * len(chosen)):
        projected = rows @ inverse
        own = np.einsum("ij,ij->i", projected, rows)
        factor = (1.0 - own[chosen])[:, None] * (1.0 + own)[None, :] + (
            projected[chosen] @ rows.T
        ) ** 2
        factor[:, chosen] = 0.0
        i, j = divmod(int(factor.argmax()), factor.shape[1])
        if factor[i, j] <= 1.0 + GAIN:
            break
        inverse = _with(_with(inverse, rows[j], 1.0), rows[chosen[i]], -1.0)
        chosen[i] = j
        if count % 50 == 49:  # rank-one updates lose digits
            inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    return chosen


def _inverse(m: Array) -> Array:
    return np.asarray(np.linalg.inv(m), dtype=float)


def _with(inverse: Array, row: Array, sign: float) -> Array:
    """(M + sign x x^T)^-1 from M^-1 (Sherman and Morrison)."""
    side = inverse @ row
    return np.asarray(inverse - np.outer(side, side) / (sign + row @ side))
