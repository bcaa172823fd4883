"""Tabu search for E-optimal plans of single rows, many plans at once.

The least eigenvalue has kinks: at a good plan several eigenvalues are nearly the least,
and no single exchange raises all of them. A step therefore takes the exchange with the
least tr M^-p, for a p that grows from stage to stage; plans are compared by their least
eigenvalue. With the resolvent of M in powers of t,

    r_ij(t) = sum_k t^k x_i^T M^-(k+1) x_j,

replacing row i by row j gives

    det(M' - t 1) / det(M - t 1) = (1 - r_ii(t)) (1 + r_jj(t)) + r_ij(t)^2 = q(t),
    tr M'^-p = tr M^-p - p [t^p] log q(t),

because -log det(1 - t M^-1) = sum_p tr(M^-p) t^p / p. The series are exact up to t^p for all
pairs at once. Their coefficients are in single precision, in the eigenbasis of M, where
each eigenvalue is divided by the least one. The information of each plan is summed anew
at each step, in double precision.

The row that leaves, and the place that is filled, rest for a few steps (Glover 1989, ORSA J.
Comput. 1, 190-206). After each stage the better half of the plans goes on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oed.base import Array, Index
from oed.design.copies import Copies, find_copies
from oed.design.tabu import better_half

#: number of plans that are searched together
TABU_PLANS = 16
#: number of plans that go on, at the least
MIN_PLANS = 4
#: plans times places times candidates, at the most
MAX_PRODUCTS = 250_000
#: steps for each that is asked for: E has more local optima than D
STEP_FACTOR = 2
#: powers of the stages
STAGE_POWERS = (1, 2, 4)
#: number of steps for which a row rests, at the most
MAX_ROW_REST = 2
#: number of steps for which a place rests, at the most
MAX_PLACE_REST = 3
#: eigenvalues are raised to at least this share of the largest
EIGENVALUE_FLOOR = 1e-9
#: factor of det M below which an exchange counts as singular
SINGULAR_FACTOR = 1e-5
#: added to traces where a row or a place is free
NO_PENALTY = np.float32(0.0)
#: added to traces where a row or a place rests: more than any trace
RESTING_PENALTY = np.float32(1e20)
#: added to traces where no copy of a row is free
NO_COPY_PENALTY = np.float32(np.inf)
#: relative gain in the least eigenvalue below which a plan counts as no better
MIN_GAIN = 1e-9

Single = NDArray[np.float32]


def search_plans(
    rows: Array, starts: Index, base: Array, steps: int, rng: np.random.Generator
) -> Index:
    """The plan (size,) of the largest least eigenvalue that the `starts` lead to.

    rows    (C, n)
    starts  (plans, size); those beyond `TABU_PLANS` and `MAX_PRODUCTS` are left out
    base    (n, n) prior information, positive semidefinite
    """
    copies = find_copies(rows)
    different = rows[copies.first]
    most = MAX_PRODUCTS // (starts.shape[1] * len(different))
    together = min(max(MIN_PLANS, most), TABU_PLANS)
    plans = copies.label[starts[:together]]
    search = _EigenvalueSearch(different, base, copies, plans, rng)
    return copies.different(search.run(STEP_FACTOR * steps))


class _EigenvalueSearch:
    """The plans, what rests, and the best plan that each of them passed.

    rows         (U, n) different rows
    plans        (B, size) of them
    free         (B, U) copies of each row that are not in the plan
    best         (B, size)
    best_values  (B,) least eigenvalues
    """

    def __init__(
        self,
        rows: Array,
        base: Array,
        copies: Copies,
        starts: Index,
        rng: np.random.Generator,
    ) -> None:
        self.rows, self.base, self.rng = rows, base, rng
        self.plans = starts.copy()
        self.free = np.tile(copies.number, (len(starts), 1))
        np.subtract.at(self.free, (np.arange(len(starts))[:, None], starts), 1)
        self.row_rests_until = np.zeros(self.free.shape, dtype=np.intp)
        self.place_rests_until = np.zeros(starts.shape, dtype=np.intp)
        self.best = self.plans.copy()
        self.best_values: Array = np.full(len(starts), -np.inf)

    def run(self, steps: int) -> Index:
        """The best plan (size,) of all stages."""
        for stage, power in enumerate(STAGE_POWERS):
            if stage:
                self._halve()
            begin = round(stage * steps / len(STAGE_POWERS))
            end = round((stage + 1) * steps / len(STAGE_POWERS))
            for step in range(begin, end):
                self._exchange(power, step)
        self._eigensystems()
        return np.asarray(self.best[int(self.best_values.argmax())])

    def _halve(self) -> None:
        """Goes on with the half that passed the better plans."""
        better = better_half(self.best, self.best_values, MIN_PLANS)
        self.plans, self.free = self.plans[better], self.free[better]
        self.best, self.best_values = self.best[better], self.best_values[better]
        self.row_rests_until = self.row_rests_until[better]
        self.place_rests_until = self.place_rests_until[better]

    def _eigensystems(self) -> tuple[Array, Array]:
        """Eigenvalues (B, n) and eigenvectors (B, n, n) of the plans; notes the best."""
        chosen = self.rows[self.plans]
        m = self.base + np.swapaxes(chosen, 1, 2) @ chosen
        eigenvalues, vectors = np.linalg.eigh(m)
        least = eigenvalues[:, 0]
        better = least > self.best_values + MIN_GAIN * np.abs(least)
        self.best_values[better] = least[better]
        self.best[better] = self.plans[better]
        floor = EIGENVALUE_FLOOR * eigenvalues[:, -1:]
        return np.maximum(eigenvalues, floor), vectors

    def _exchange(self, power: int, step: int) -> None:
        """Replaces one row in each plan; what changed rests."""
        batch = np.arange(len(self.plans))
        traces = self._traces_after_exchange(power)
        traces += np.where(self.row_rests_until > step, RESTING_PENALTY, NO_PENALTY)[
            :, None, :
        ]
        traces += np.where(self.free < 1, NO_COPY_PENALTY, NO_PENALTY)[:, None, :]
        traces += np.where(self.place_rests_until > step, RESTING_PENALTY, NO_PENALTY)[
            :, :, None
        ]
        # a copy in place of its row changes nothing, and would use up the step
        places = np.arange(self.plans.shape[1])
        traces[batch[:, None], places, self.plans] = np.inf
        best = traces.reshape(len(batch), -1).argmin(axis=1)
        position, row = np.divmod(best, traces.shape[2])
        removed = self.plans[batch, position]
        row = np.where(np.isfinite(traces[batch, position, row]), row, removed)
        self.plans[batch, position] = row
        self.free[batch, removed] += 1
        self.free[batch, row] -= 1
        share = self.rng.random((2, len(batch)))
        row_steps = (share[0] * MAX_ROW_REST).astype(np.intp)
        place_steps = (share[1] * MAX_PLACE_REST).astype(np.intp)
        self.row_rests_until[batch, removed] = step + 2 + row_steps
        self.place_rests_until[batch, position] = step + 2 + place_steps

    def _traces_after_exchange(self, power: int) -> Single:
        """l^p tr M'^-p (B, size, U) of all exchanges, with the least eigenvalue l of M."""
        eigenvalues, vectors = self._eigensystems()
        relative = eigenvalues[:, :1] / eigenvalues
        to_white = vectors / np.sqrt(eigenvalues)[:, None, :]
        others = (self.rows @ to_white).astype(np.float32)
        chosen = others[np.arange(len(others))[:, None], self.plans]
        before = np.sum(relative**power, axis=1).astype(np.float32)
        # the products of a plan that is nearly singular may exceed single precision
        with np.errstate(over="ignore", invalid="ignore"):
            q = _determinant_series(chosen, others, relative, power)
            factor = np.maximum(q[0], np.float32(SINGULAR_FACTOR))
            scaled: list[Single] = [np.divide(term, factor) for term in q[1:]]
            traces: Single = before[:, None, None] - _last_power_sum(scaled)
        unsound = (q[0] < SINGULAR_FACTOR) | np.isnan(traces)
        traces[unsound] = np.inf
        return traces


def _determinant_series(
    chosen: Single, others: Single, relative: Array, power: int
) -> list[Single]:
    """Coefficients (B, size, U) of q up to t^power, for t in units of the least eigenvalue.

    chosen    (B, size, n) and others (B, U, n), rows whitened by M
    relative  (B, n) least eigenvalue over each one
    """
    scales = (relative[:, :, None] ** np.arange(power + 1)).astype(np.float32)
    columns = np.swapaxes(others, 1, 2)
    cross = [(chosen * scales[:, None, :, k]) @ columns for k in range(power + 1)]
    leaving = -(chosen**2) @ scales
    coming = others**2 @ scales
    leaving[:, :, 0] += 1.0
    coming[:, :, 0] += 1.0
    series = []
    for order in range(power + 1):
        right = np.swapaxes(coming[:, :, order::-1], 1, 2)
        term = leaving[:, :, : order + 1] @ right
        for k in range((order + 1) // 2):
            term += 2.0 * cross[k] * cross[order - k]
        if order % 2 == 0:
            term += cross[order // 2] ** 2
        series.append(term)
    return series


def _last_power_sum(series: list[Single]) -> Single:
    """p [t^p] log(1 + sum_m series_m t^m), for series_1 to series_p."""
    sums: list[Single] = []
    for order, term in enumerate(series, start=1):
        power_sum = order * term
        for k, earlier in enumerate(sums, start=1):
            power_sum -= earlier * series[order - k - 1]
        sums.append(power_sum)
    return sums[-1]
