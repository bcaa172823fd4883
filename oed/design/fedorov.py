"""D-optimal exchange of single rows by Fedorov's formula, for all pairs at once.

Replacing row i by row j multiplies det M by

    (1 - d_ii)(1 + d_jj) + d_ij^2,        d_ij = x_i^T M^-1 x_j        (Fedorov 1972).
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array, Index

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
        factors = _determinant_factors(rows, chosen, inverse)
        i, j = divmod(int(factors.argmax()), factors.shape[1])
        if factors[i, j] <= 1.0 + GAIN:
            break
        added = _update(inverse, rows[j], 1.0)
        inverse = _update(added, rows[chosen[i]], -1.0)
        chosen[i] = j
        if count % REFRESH == REFRESH - 1:
            inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    return chosen


def _determinant_factors(rows: Array, chosen: Index, inverse: Array) -> Array:
    """Factor of det M for replacing each chosen row by each row (chosen, C)."""
    projected = rows @ inverse
    leverage = np.einsum("ij,ij->i", projected, rows)
    cross = (projected[chosen] @ rows.T) ** 2
    factors = (1.0 - leverage[chosen])[:, None] * (1.0 + leverage)[None, :] + cross
    factors[:, chosen] = 0.0
    return np.asarray(factors)


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=float)


def _update(inverse: Array, row: Array, sign: float) -> Array:
    """(M + sign x x^T)^-1 from M^-1 (Sherman and Morrison)."""
    side = inverse @ row
    return np.asarray(inverse - np.outer(side, side) / (sign + row @ side))
