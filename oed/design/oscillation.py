"""Search of many plans at once: each grows by a candidate or two, then shrinks again.

With D_j = X_j P X_j^T and S_j = X_j T X_j^T of every candidate, P = M^-1 and T = P W P,
adding (sign +) or dropping (sign -) one changes det M by the factor det(1 +- D_j), and
tr(W P) by -+ tr((1 +- D_j)^-1 S_j). After a move of block X, with

    U = P X^T A^(-1/2),    V = T X^T A^(-1/2),    A = 1 +- X P X^T,    Z = U^T W U,

    P' = P -+ U U^T,       T' = T -+ (U V^T + V U^T) + U Z U^T,

so that tr D_j and tr S_j of all candidates follow from products of low rank, for all plans
at once. Single rows are compared by these. Of blocks, those of the largest traces are
compared by their matrices.

What was added or dropped rests for a few steps, so that a plan climbs out of a local
optimum (strategic oscillation: Glover 1989, ORSA J. Comput. 1, 190-206; excursions:
Mitchell 1974, Technometrics 16, 203-210).
"""

from __future__ import annotations

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import information
from oed.design.forms import Criterion
from oed.linear_algebra import symmetric_inverse

#: candidates by which a plan grows in a step; one of these numbers is drawn
EXCURSIONS = (1, 2)
#: steps for which what was added or dropped rests, at the most: near saturation longer
#: rests keep a plan from its optimum
MAX_REST = 4
#: steps after which matrices are formed anew: each step loses digits
STEPS_FRESH = 40
#: blocks that are compared by their matrices
SHORTLIST_BLOCKS = 24
#: eigenvalues of 1 - D_i are raised to at least this
SINGULAR_SHARE = 1e-12
#: gain in log phi below which a plan counts as no better
MIN_GAIN = 1e-10
#: below every score, and above that of what must not be taken
RESTING_SCORE = -1e300


class Oscillation:
    """B plans on their way, by a criterion with `has_move_formulas`.

    members, stays  (B, L) candidates, and the step until which each stays
    free            (B, C) copies that are not in the plan
    dropped, out    (B, D) candidates that left last, and the step until which they rest
    best            (B, size) best plan of each so far
    best_value      (B,) log phi
    value           (B,) log phi, for D log det M
    inverse         (B, n, n) P
    weighted        (B, n, n) T, over tr(W P) when formed anew; none for D
    traces          (B, C) tr D_j
    weighted_traces (B, C) tr S_j with this T
    """

    def __init__(
        self,
        blocks: Array,
        copies: Index,
        plans: Index,
        base: Array,
        criterion: Criterion,
    ) -> None:
        self.blocks, self.base, self.criterion = blocks, base, criterion
        self.columns = np.ascontiguousarray(blocks.reshape(-1, len(base)).T)
        self.plans = np.arange(len(plans))
        self.by_plan = self.plans[:, None]
        self.free = np.tile(copies, (len(plans), 1))
        np.subtract.at(self.free, (self.by_plan, plans), 1)
        self.members, self.stays = plans.copy(), np.zeros_like(plans)
        resting = len(plans), MAX_REST * max(EXCURSIONS)
        self.dropped = np.zeros(resting, dtype=np.intp)
        self.out = np.zeros_like(self.dropped)
        self.best, self.best_value = plans.copy(), np.full(len(plans), -np.inf)
        self.has_weight = not criterion.any_coordinates
        self.step = 0
        self._refresh()

    def run(self, steps: int, rng: np.random.Generator) -> None:
        """Takes so many steps; none where all candidates are in a plan."""
        if int(self.free[0].sum()) < max(EXCURSIONS):
            return
        for self.step in range(1, steps + 1):
            excursion = EXCURSIONS[rng.integers(len(EXCURSIONS))]
            for _ in range(excursion):
                self._add(rng)
            for _ in range(excursion):
                self._drop(rng)
            if self.step % STEPS_FRESH == 0:
                self._refresh()
            self._note()

    def _refresh(self) -> None:
        """Forms matrices and values anew from the plans."""
        m = np.array([self.base + information(self.blocks[p]) for p in self.members])
        self.inverse = np.array([symmetric_inverse(each) for each in m])
        self.traces = self._traces_of(self.inverse)
        if not self.has_weight:
            self.value = np.linalg.slogdet(m)[1]
            return
        self.value = np.array([self.criterion.value(each) for each in m])
        self.fresh_value, self.share = self.value, np.ones(len(m))
        # the gradient matrix of -log tr(W P) is T / tr(W P)
        self.weighted = np.array([self.criterion.gradient_matrix(each) for each in m])
        self.weighted_traces = self._traces_of(self.weighted)

    def _traces_of(self, matrices: Array) -> Array:
        """tr X_j Q X_j^T (B, C) of matrices Q (B, n, n)."""
        count, k, n = self.blocks.shape
        rows = self.blocks.reshape(-1, n)
        forms = [np.einsum("ij,ij->i", rows @ q, rows) for q in matrices]
        return np.array(forms).reshape(len(matrices), count, k).sum(axis=2)

    def _note(self) -> None:
        """Keeps the plans that are the best so far."""
        better = self.value > self.best_value + MIN_GAIN
        self.best_value[better] = self.value[better]
        self.best[better] = self.members[better]

    def _add(self, rng: np.random.Generator) -> None:
        """Adds to each plan the candidate that raises its value most."""
        scores = self._quick_scores()
        resting = np.where(self.out > self.step, RESTING_SCORE, np.inf)
        at_rest = np.minimum(scores[self.by_plan, self.dropped], resting)
        scores[self.by_plan, self.dropped] = at_rest
        used_up = self.free[self.by_plan, self.members] == 0
        of_members = scores[self.by_plan, self.members]
        scores[self.by_plan, self.members] = np.where(used_up, -np.inf, of_members)
        if self.blocks.shape[1] == 1:
            added = scores.argmax(axis=1)
        else:
            most = min(SHORTLIST_BLOCKS, scores.shape[1])
            shortlist = np.argpartition(-scores, most - 1, axis=1)[:, :most]
            quick = scores[self.by_plan, shortlist]
            exact = self._scores(shortlist, 1.0)
            exact = np.where(quick > RESTING_SCORE, exact, quick)
            added = shortlist[self.plans, exact.argmax(axis=1)]
        self.free[self.plans, added] -= 1
        self.members = np.column_stack([self.members, added])
        self.stays = np.column_stack([self.stays, self._until(rng)])
        self._move(added, 1.0)

    def _drop(self, rng: np.random.Generator) -> None:
        """Drops from each plan the member whose loss lowers its value least."""
        scores = self._scores(self.members, -1.0)
        scores[self.stays > self.step] = RESTING_SCORE
        place = scores.argmax(axis=1)
        left = self.members[self.plans, place]
        for array in (self.members, self.stays):
            array[self.plans, place] = array[:, -1]
        self.members, self.stays = self.members[:, :-1], self.stays[:, :-1]
        self.free[self.plans, left] += 1
        self.dropped = np.column_stack([self.dropped[:, 1:], left])
        self.out = np.column_stack([self.out[:, 1:], self._until(rng)])
        self._move(left, -1.0)

    def _until(self, rng: np.random.Generator) -> Index:
        """Steps (B,) until which what moves now rests."""
        return self.step + rng.integers(1, MAX_REST + 1, len(self.plans))

    def _quick_scores(self) -> Array:
        """What adding each candidate (B, C) brings: exact for rows, a bound for blocks."""
        if not self.has_weight:
            return self.traces.copy()
        if self.blocks.shape[1] > 1:
            return self.weighted_traces.copy()
        return np.asarray(self.weighted_traces / (1.0 + self.traces))

    def _scores(self, candidates: Index, sign: float) -> Array:
        """What a move of each candidate (B, L) brings."""
        if self.blocks.shape[1] == 1:
            factor = 1.0 + sign * self.traces[self.by_plan, candidates]
            factor = np.maximum(factor, SINGULAR_SHARE)
            if not self.has_weight:
                return factor
            return sign * self.weighted_traces[self.by_plan, candidates] / factor
        x = self.blocks[candidates]
        turned = np.swapaxes(x, 2, 3)
        sums = np.eye(x.shape[2]) + sign * (x @ self.inverse[:, None] @ turned)
        if not self.has_weight:
            return np.asarray(np.linalg.det(sums))
        solved = np.linalg.solve(sums, x @ self.weighted[:, None] @ turned)
        return np.asarray(sign * np.trace(solved, axis1=2, axis2=3))

    def _move(self, moved: Index, sign: float) -> None:
        """Changes matrices, traces and values after a move of candidates (B,)."""
        x = self.blocks[moved]
        side = x @ self.inverse
        turned = np.swapaxes(x, 1, 2)
        root, log_det = _inverse_root(np.eye(x.shape[1]) + sign * side @ turned)
        u = root @ side  # U^T
        self.inverse -= sign * np.swapaxes(u, 1, 2) @ u
        if not self.has_weight:
            self.value = self.value + log_det
            self.traces -= sign * self._sums(u)[0]
            return
        v = root @ x @ self.weighted  # V^T
        z = v @ turned @ np.swapaxes(root, 1, 2)
        half = 0.5 * z @ u - sign * v
        change = np.swapaxes(u, 1, 2) @ half
        self.weighted += change + np.swapaxes(change, 1, 2)
        squares, products = self._sums(u, half)
        self.traces -= sign * squares
        self.weighted_traces += 2.0 * products
        self.share = self.share - sign * np.trace(z, axis1=1, axis2=2)
        self.value = self.fresh_value - np.log(np.maximum(self.share, 1e-300))

    def _sums(self, *sides: Array) -> list[Array]:
        """Sums (B, C) over both k of X_j U times X_j U, X_j V: of U^T, V^T (B, k, n)."""
        count, k, n = sides[0].shape
        across = [side.reshape(-1, n) @ self.columns for side in sides]
        if k == 1:
            return [across[0] * each for each in across]
        first, *_ = across = [each.reshape(count, k, -1) for each in across]
        sums = [np.einsum("bij,bij->bj", first, each) for each in across]
        return [each.reshape(count, -1, k).sum(axis=2) for each in sums]


def _inverse_root(matrices: Array) -> tuple[Array, Array]:
    """Q (B, k, k) with Q A Q^T = 1, and log det A (B,), of matrices A (B, k, k)."""
    if matrices.shape[1] == 1:
        shares = np.maximum(matrices, SINGULAR_SHARE)
        return 1.0 / np.sqrt(shares), np.log(shares[:, 0, 0])
    shares, vectors = np.linalg.eigh(matrices)
    shares = np.maximum(shares, SINGULAR_SHARE)
    root = np.swapaxes(vectors / np.sqrt(shares)[:, None, :], 1, 2)
    return root, np.log(shares).sum(axis=1)
