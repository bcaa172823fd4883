"""Greedy choice and exchange of single readings by rank-one updates: a mean variance, D.

For a mean variance, with P = M^-1, the variance t = tr(F P F^T), and for rows x_i

    d_ij = x_i^T P x_j,    g_i = F P x_i,

adding row i lowers t by |g_i|^2 / (1 + d_ii). Taking row j out first makes that

    t + |g_j|^2 / c - |g_i + (d_ij / c) g_j|^2 / (1 + d_ii + d_ij^2 / c),    c = 1 - d_jj

(Sherman and Morrison 1950). One inverse therefore serves all exchanges of a design.

The D-optimal exchange knows all pairs at once. Replacing row i by row j multiplies det M by

    (1 - d_ii)(1 + d_jj) + d_ij^2,        d_ij = x_i^T M^-1 x_j        (Fedorov 1972).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.design.forms.protocol import parts, quadratic_forms
from oed.linear_algebra import symmetric_inverse

#: gain in log t below which an exchange counts as none
MIN_LOG_GAIN = 1e-10
#: share 1 - d_jj of a row's own information below which the row is taken out exactly:
#: the formula would lose digits
MIN_OWN_SHARE = 1e-4
#: places whose exchanges are computed together
PLACES_AT_ONCE = 12
#: relative gain of det M below which an exchange counts as none
MIN_FACTOR_GAIN = 1e-9
#: exchanges after which the inverse is computed anew: rank-one updates lose digits
REFRESH_EXCHANGES = 50


@dataclasses.dataclass(frozen=True, eq=False)
class RowExchange:
    """Candidates of one row each, and the variance that they are chosen for.

    rows    (C, n) whitened
    factor  F (r, n)
    base    (n, n) positive definite information before
    """

    rows: Array
    factor: Array
    base: Array

    def select_greedily(self, size: int) -> Index:
        """Rows added one by one, each the one that lowers the variance most."""
        sides = self.rows @ symmetric_inverse(self.base)
        leverage = np.einsum("ij,ij->i", sides, self.rows)
        n = len(self.base)
        sides = np.hstack([sides, sides @ self.factor.T])
        gains = sides[:, n:]
        chosen: list[int] = []
        for _ in range(min(size, len(self.rows))):
            lowered = np.einsum("ij,ij->i", gains, gains) / (1.0 + leverage)
            lowered[chosen] = -np.inf
            best = int(np.argmax(lowered))
            chosen.append(best)
            cross = sides[:, :n] @ self.rows[best]
            share = cross / (1.0 + leverage[best])
            leverage -= cross * share
            sides -= share[:, None] * sides[best]
        return np.array(chosen, dtype=np.intp)

    def exchange(self, chosen: Index, sweeps: int) -> Index:
        """Each row in turn replaced by the best one, in at most so many sweeps."""
        chosen = chosen.copy()
        for _ in range(sweeps):
            if not self._sweep(chosen):
                break
        return chosen

    def variance(self, chosen: Index) -> float:
        """Variance t of a design."""
        return _Design(self, chosen).variance

    def _sweep(self, chosen: Index) -> bool:
        """Exchanges, in place, of each row in turn; whether there were any."""
        changed = False
        design, position = _Design(self, chosen), 0
        while position < len(chosen):
            places = np.arange(position, min(position + PLACES_AT_ONCE, len(chosen)))
            variances = design.variances_after_exchange(places)
            best = np.argmin(variances, axis=1)
            lowest = variances[np.arange(len(places)), best]
            helps = lowest < design.variance * np.exp(-MIN_LOG_GAIN)
            position = int(places[-1]) + 1
            if helps.any():
                first = int(np.argmax(helps))
                chosen[places[first]] = best[first]
                design, position = _Design(self, chosen), int(places[first]) + 1
                changed = True
        return changed


class _Design:
    """Chosen rows, with what all exchanges need."""

    def __init__(self, problem: RowExchange, chosen: Index) -> None:
        self._problem, self._chosen = problem, chosen
        rows, factor = problem.rows, problem.factor
        inverted = self._general_inverse(chosen)
        self._sides = rows @ inverted
        self._gains = self._sides @ factor.T
        self._leverage = np.einsum("ij,ij->i", self._sides, rows)
        self._reduction = np.einsum("ij,ij->i", self._gains, self._gains)
        self.variance = float(np.sum((factor @ inverted) * factor))

    def variances_after_exchange(self, places: Index) -> Array:
        """Variances (m, C) with the row at each place (m,) replaced by each row.

        inf for rows that are chosen already.
        """
        replaced = self._chosen[places]
        share = 1.0 - self._leverage[replaced]
        safe = np.maximum(share, MIN_OWN_SHARE)
        cross = self._sides[replaced] @ self._problem.rows.T
        scaled = cross / safe[:, None]
        lost = self._reduction[replaced]
        gained = self._gains[replaced] @ self._gains.T
        reduction = self._reduction + scaled * (2.0 * gained + scaled * lost[:, None])
        leverage = self._leverage + cross * scaled
        without = self.variance + lost / safe
        variances = without[:, None] - reduction / (1.0 + leverage)
        for k in np.flatnonzero(share < MIN_OWN_SHARE):
            variances[k] = self._variances_exactly(places[k])
        variances[:, self._chosen] = np.inf
        return np.asarray(variances)

    def _variances_exactly(self, position: int) -> Array:
        """Variances (C,) of the other rows with each row added."""
        rows, factor = self._problem.rows, self._problem.factor
        inverted = self._general_inverse(np.delete(self._chosen, position))
        sides = rows @ inverted
        gains = sides @ factor.T
        leverage = np.einsum("ij,ij->i", sides, rows)
        reduction = np.einsum("ij,ij->i", gains, gains)
        variance = np.sum((factor @ inverted) * factor)
        return np.asarray(variance - reduction / (1.0 + leverage))

    def _general_inverse(self, chosen: Index) -> Array:
        rows = self._problem.rows[chosen]
        return symmetric_inverse(self._problem.base + rows.T @ rows)


def exchange_rows(rows: Array, chosen: Index, base: Array) -> Index:
    """Exchanges the best pair of rows (C, n) until no exchange raises the determinant.

    base (n, n) is the positive definite prior information.
    """
    chosen = chosen.copy()
    inverse = _general_inverse(rows[chosen].T @ rows[chosen] + base)
    for count in range(100 * len(chosen)):
        i, j, factor = _best_pair(rows, chosen, inverse)
        if factor <= 1.0 + MIN_FACTOR_GAIN:
            break
        added = _update(inverse, rows[j], 1.0)
        inverse = _update(added, rows[chosen[i]], -1.0)
        chosen[i] = j
        if count % REFRESH_EXCHANGES == REFRESH_EXCHANGES - 1:
            inverse = _general_inverse(rows[chosen].T @ rows[chosen] + base)
    return chosen


def _best_pair(rows: Array, chosen: Index, inverse: Array) -> tuple[int, int, float]:
    """Place and row whose exchange raises det M most, and the factor.

    Part by part, so that the factors of all pairs are not in memory at once.
    """
    in_plan = np.zeros(len(rows), dtype=bool)
    in_plan[chosen] = True
    sides = rows[chosen] @ inverse
    remaining = 1.0 - np.einsum("ij,ij->i", sides, rows[chosen])
    best = 0, 0, -np.inf
    for part in parts(len(rows)):
        leverage = quadratic_forms(rows[part], inverse)
        cross = sides @ rows[part].T
        factors = remaining[:, None] * (1.0 + leverage)[None, :] + cross**2
        factors[:, in_plan[part]] = 0.0
        i, j = divmod(int(factors.argmax()), factors.shape[1])
        if factors[i, j] > best[2]:
            best = i, part.start + j, float(factors[i, j])
    return best


def _general_inverse(matrix: Array) -> Array:
    """The inverse by elimination; `inverse` would differ in its last digits."""
    return np.asarray(np.linalg.inv(matrix), dtype=float)


def _update(inverse: Array, row: Array, sign: float) -> Array:
    """(M + sign x x^T)^-1 from M^-1 (Sherman and Morrison)."""
    side = inverse @ row
    return inverse - np.outer(side, side) / (sign + row @ side)
