"""D-optimal exchange of single rows by Fedorov's formula, for all pairs at once.

Replacing row i by row j multiplies det M by

    (1 - d_ii)(1 + d_jj) + d_ij^2,        d_ij = x_i^T M^-1 x_j        (Fedorov 1972).
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index
from oed.design.criterion.protocol import parts, quadratic_forms

#: relative gain below which an exchange counts as none
GAIN = 1e-9
#: exchanges after which the inverse is computed anew: rank-one updates lose digits
REFRESH = 50


def exchange_rows(rows: Array, chosen: Index, base: Array) -> Index:
    """Exchanges the best pair of rows (C, n) until no exchange raises the determinant.

    base (n, n) is the positive definite prior information.
    """
    chosen = chosen.copy()
    inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    for count in range(100 * len(chosen)):
        i, j, factor = _best_pair(rows, chosen, inverse)
        if factor <= 1.0 + GAIN:
            break
        added = _update(inverse, rows[j], 1.0)
        inverse = _update(added, rows[chosen[i]], -1.0)
        chosen[i] = j
        if count % REFRESH == REFRESH - 1:
            inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    return chosen


def _best_pair(rows: Array, chosen: Index, inverse: Array) -> tuple[int, int, float]:
    """Place and row whose exchange raises det M most, and the factor.

    Part by part, so that the factors of all pairs are not in memory at once.
    """
    held = np.zeros(len(rows), dtype=bool)
    held[chosen] = True
    sides = rows[chosen] @ inverse
    remaining = 1.0 - np.einsum("ij,ij->i", sides, rows[chosen])
    best = 0, 0, -np.inf
    for part in parts(len(rows)):
        leverage = quadratic_forms(rows[part], inverse)
        cross = sides @ rows[part].T
        factors = remaining[:, None] * (1.0 + leverage)[None, :] + cross**2
        factors[:, held[part]] = 0.0
        i, j = divmod(int(factors.argmax()), factors.shape[1])
        if factors[i, j] > best[2]:
            best = i, part.start + j, float(factors[i, j])
    return best


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=float)


def _update(inverse: Array, row: Array, sign: float) -> Array:
    """(M + sign x x^T)^-1 from M^-1 (Sherman and Morrison)."""
    side = inverse @ row
    return inverse - np.outer(side, side) / (sign + row @ side)
