"""Tabu search for D-optimal plans of single rows, many plans at once.

In every plan, one step replaces the chosen row i by the row j that raises det M most, or
lowers it least. With d_ij = x_i^T M^-1 x_j, the factor of det M is

    (1 - d_ii)(1 + d_jj) + d_ij^2        (Fedorov 1972).

The row that leaves, and the place that is filled, rest for a few steps, so that the
search climbs out of a local optimum and does not return to it (Glover 1989, ORSA J.
Comput. 1, 190-206). All plans take their step in the same array operations. M^-1 and
the d_ij of the chosen rows follow by rank-two updates, in single precision on whitened
rows. They are computed anew from time to time, and plans are compared in double
precision at the end. Twice, the half of the plans that has come less far is given up
(successive halving; Jamieson and Talwalkar 2016, AISTATS).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oed.base import Array, Index
from oed.design.copies import find_copies

#: plans that are searched together
TABU_PLANS = 30
#: places times candidates beyond which one plan's products are too many
MAX_PLACE_CANDIDATES = 250_000
#: most steps for which a row, or a place, rests, in turn for the plans: short rests
#: climb fast, long ones leave wide basins
TENURES = (2, 3, 3, 4, 8)
#: steps after which all products are computed anew
REFRESH_STEPS = 60
#: shares of the steps after which the better half of the plans goes on alone: a plan in
#: a good basin shows early
HALVING_SHARES = (1 / 6, 1 / 3)
#: plans that go on at the least: those with short rests alone may go in circles
MIN_PLANS = 8
#: prior information added in whitened units: random plans can be singular
WHITE_RIDGE = 1e-6
#: gain in log det below which a step counts as none, in single precision
MIN_GAIN = 1e-5
#: factor of det M below which, or above whose inverse, updates are not sound: a plan is
#: or was nearly singular, and all is computed anew
UNSOUND_FACTOR = 1e-3
#: least share of a row that is its own
MIN_OWN_SHARE = 1e-6
#: added to the factor of det M where a row or a place rests: more than any factor
RESTING_PENALTY = -1e6
#: added where no copy of a row is free: less than a row and a place that rest
NO_COPY_PENALTY = -4e6

Single = NDArray[np.float32]


def search_plans(
    rows: Array, starts: Index, base: Array, steps: int, rng: np.random.Generator
) -> Index:
    """The best plan (size,) that the plans `starts` (plans, size) pass in their steps.

    rows   (C, n)
    base   (n, n) prior information, positive semidefinite

    Rows and prior together determine all n directions, and a plan has n rows or more:
    where the prior alone determines a direction, single precision does not resolve it.
    """
    white, white_base = _whiten(rows, base)
    copies = find_copies(rows)
    different = white[copies.first]
    plans = copies.label[starts]
    search = _TabuSearch(different, white_base, copies.number, plans, rng)
    best_plans = search.run(steps)
    values = _log_determinants(different, white_base, best_plans)
    return copies.different(best_plans[int(values.argmax())])


def better_half(best: Index, values: Array, least: int) -> Index:
    """Numbers, ascending, of the half that passed the better plans, at least so many.

    best    (B, size) plan that each passed;  values (B,) of them

    Of those that passed the same plan, one goes before all that come after it.
    """
    passed = np.sort(best, axis=1)
    _, first = np.unique(passed, axis=0, return_index=True)
    again = np.ones(len(passed), dtype=bool)
    again[first] = False
    order = np.lexsort((-values, again))
    return np.sort(order[: max(least, len(order) // 2)])


def _whiten(rows: Array, base: Array) -> tuple[Array, Array]:
    """Rows and prior in coordinates where all rows and the prior have information C."""
    eigenvalues, vectors = np.linalg.eigh(base)
    prior_rows = np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * vectors.T
    triangle = np.linalg.qr(np.vstack([rows, prior_rows]), mode="r")
    inverse = np.linalg.inv(triangle) * np.sqrt(len(rows))
    white_prior = prior_rows @ inverse
    return rows @ inverse, white_prior.T @ white_prior


def _information(white: Array, base: Array, plans: Index) -> Array:
    """M (plans, n, n)."""
    chosen = white[plans]
    return base + np.swapaxes(chosen, 1, 2) @ chosen


def _log_determinants(white: Array, base: Array, plans: Index) -> Array:
    sign, values = np.linalg.slogdet(_information(white, base, plans))
    return np.where(sign > 0, values, -np.inf)


class _TabuSearch:
    """The plans, their products with all candidates, and what rests.

    Candidates are different rows, of which there may be several copies.

    plans     (B, size)
    free      (B, C) copies that are not in the plan
    inverse   (B, n, n) M^-1
    products  (B, size, C) d_ij of chosen rows with all rows
    leverage  (B, C) d_jj
    """

    def __init__(
        self,
        white: Array,
        base: Array,
        number: Index,
        starts: Index,
        rng: np.random.Generator,
    ) -> None:
        self.white, self.rng = white, rng
        self.base = base + WHITE_RIDGE * np.eye(len(base))
        self.rows = white.astype(np.float32)
        self.columns = np.ascontiguousarray(self.rows.T)
        self.has_copies = bool(number.max() > 1)
        self.plans = starts.copy()
        self.batch = np.arange(len(starts))
        self.tenures = np.resize(TENURES, len(starts))
        count, size = len(white), starts.shape[1]
        self.free = np.tile(number, (len(starts), 1))
        np.subtract.at(self.free, (self.batch[:, None], starts), 1)
        self.row_rests_until = np.zeros((len(starts), count), dtype=np.intp)
        self.place_rests_until = np.zeros(starts.shape, dtype=np.intp)
        self.place_terms = np.ones((len(starts), size, 3), dtype=np.float32)
        self.row_terms = np.ones((len(starts), 3, count), dtype=np.float32)
        self._refresh()
        self.best, self.best_values = self.plans.copy(), self.values

    def _refresh(self) -> None:
        """Computes inverse, products and values anew, in double precision."""
        m = _information(self.white, self.base, self.plans)
        inverse = np.linalg.inv(m)
        products = (self.white[self.plans] @ inverse) @ self.white.T
        by_row = self.white @ inverse
        leverage = np.einsum("bcn,cn->bc", by_row, self.white)
        self.inverse: Single = inverse.astype(np.float32)
        self.products: Single = products.astype(np.float32)
        self.leverage: Single = leverage.astype(np.float32)
        self.factors = np.empty_like(self.products)
        self.values: Array = np.linalg.slogdet(m)[1]

    def run(self, steps: int) -> Index:
        """The best plan (B, size) that each plan passed."""
        halving = {round(share * steps) for share in HALVING_SHARES}
        for step in range(steps):
            if step in halving:
                self._halve()
            position, row, factor = self._best_exchange(step)
            self._exchange(position, row, step)
            self.values = self.values + np.log(np.maximum(factor, UNSOUND_FACTOR))
            sound = (
                factor.min() > UNSOUND_FACTOR and factor.max() < 1.0 / UNSOUND_FACTOR
            )
            if step % REFRESH_STEPS == REFRESH_STEPS - 1 or not sound:
                self._refresh()
            better = np.flatnonzero(self.values > self.best_values + MIN_GAIN)
            self.best_values[better] = self.values[better]
            self.best[better] = self.plans[better]
        return self.best

    def _halve(self) -> None:
        """Goes on with the half that passed the better plans."""
        better = better_half(self.best, self.best_values, MIN_PLANS)
        self.batch = np.arange(len(better))
        self.plans, self.values = self.plans[better], self.values[better]
        self.best, self.best_values = self.best[better], self.best_values[better]
        self.tenures = np.resize(TENURES, len(better))
        self.free = self.free[better]
        self.inverse, self.products = self.inverse[better], self.products[better]
        self.leverage, self.factors = self.leverage[better], self.factors[better]
        self.row_rests_until = self.row_rests_until[better]
        self.place_rests_until = self.place_rests_until[better]
        self.place_terms = self.place_terms[better]
        self.row_terms = self.row_terms[better]

    def _best_exchange(self, step: int) -> tuple[Index, Index, Single]:
        """Place, row and factor of the best allowed exchange of each plan (B,).

        One product of three terms gives (1 - d_ii)(1 + d_jj) with both prohibitions.
        """
        resting = self.row_rests_until > step
        chosen_leverage = self.leverage[self.batch[:, None], self.plans]
        self.place_terms[:, :, 0] = 1.0 - chosen_leverage
        self.row_terms[:, 0] = 1.0 + self.leverage
        self.row_terms[:, 1] = np.where(resting, RESTING_PENALTY, 0.0)
        self.row_terms[:, 1][self.free < 1] = NO_COPY_PENALTY
        place_rests = self.place_rests_until > step
        self.place_terms[:, :, 2] = np.where(place_rests, RESTING_PENALTY, 0.0)
        np.multiply(self.products, self.products, out=self.factors)
        self.factors += np.matmul(self.place_terms, self.row_terms)
        if self.has_copies:
            # a copy in place of its row changes nothing, and would use up the step
            places = np.arange(self.plans.shape[1])
            self.factors[self.batch[:, None], places, self.plans] = NO_COPY_PENALTY
        flat = self.factors.reshape(len(self.plans), -1)
        best = flat.argmax(axis=1)
        position, row = np.divmod(best, self.products.shape[2])
        return position, row, flat[self.batch, best]

    def _exchange(self, position: Index, row: Index, step: int) -> None:
        """Replaces one row in each plan; what changed rests."""
        removed = self.plans[self.batch, position]
        self.plans[self.batch, position] = row
        self._update_products(position, row, removed)
        self.free[self.batch, removed] += 1
        self.free[self.batch, row] -= 1
        share = self.rng.random((2, len(row)))
        rests_until = step + 2 + (share * self.tenures).astype(np.intp)
        self.row_rests_until[self.batch, removed] = rests_until[0]
        self.place_rests_until[self.batch, position] = rests_until[1]

    def _update_products(self, position: Index, row: Index, removed: Index) -> None:
        """Sherman and Morrison for the row that comes, then for the one that leaves."""
        batch = self.batch
        side_in = np.matmul(self.inverse, self.rows[row][:, :, None])[:, :, 0]
        with_in = side_in @ self.columns
        before = self.products[batch, position]
        scale_in = 1.0 / (1.0 + self.leverage[batch, row])
        share = before[batch, row] * scale_in
        side_before = np.matmul(self.inverse, self.rows[removed][:, :, None])
        side_out = side_before[:, :, 0] - share[:, None] * side_in
        with_out = before - share[:, None] * with_in
        remaining = 1.0 - with_out[batch, removed]
        scale_out = 1.0 / np.maximum(remaining, np.float32(MIN_OWN_SHARE))
        scales = np.stack([-scale_in, scale_out], axis=1)
        sides = np.stack([side_in, side_out], axis=1)
        scaled_sides = sides * scales[:, :, None]
        self.inverse += np.matmul(np.swapaxes(scaled_sides, 1, 2), sides)
        with_both = np.stack([with_in, with_out], axis=1)
        self.products[batch, position] = with_in
        # (B, size, 2)
        chosen = with_both[batch[:, None], :, self.plans]
        np.matmul(chosen * scales[:, None, :], with_both, out=self.factors)
        self.products += self.factors
        self.leverage += scale_out[:, None] * with_out**2
        self.leverage -= scale_in[:, None] * with_in**2
