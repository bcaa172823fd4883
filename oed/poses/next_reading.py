"""The best next reading from a posterior: which candidate makes a goal most accurate.

A candidate block H (k, n) of whitened rows lowers the covariance C of the columns by
the Kalman update (README). The variance of the combinations F (r, n) is tr(W C) with W
= F^T F. With the Cholesky factor L of I + H C H^T and G = L^-1 H C it falls by tr(G W
G^T).

A step takes the candidate with the smallest sum of log variances over the goal's
components: each counts by the share that it loses, whatever its unit.

One reading alone is a short-sighted choice. So the readings that remain are planned
together, by exchange (Fedorov, Theory of Optimal Experiments, 1972, chapter 3), and the
one among them that gains most by itself is taken first.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array

#: weight of the sum of log variances beside what is lacking to the limits
BEYOND_LIMITS_WEIGHT = 1e-2
MAX_SWEEPS = 2  #: exchanges of every reading, at the most


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """What is known, and what should become accurate."""

    covariance: Array  #: (n, n) of the columns, as scaled in the candidates' blocks
    #: (K, n, n) W = F^T F of each component's combinations F (r, n); its variance is
    #: tr(W C)
    weights: Array

    @classmethod
    def build(cls, covariance: Array, factors: Array) -> "Belief":
        """With the weights of each component's combinations `factors` (K, r, n)."""
        return cls(covariance, factors.swapaxes(1, 2) @ factors)

    @property
    def variances(self) -> Array:
        """Variance (K,) of each component."""
        return np.tensordot(self.weights, self.covariance, axes=2)

    def after(self, block: Array) -> "Belief":
        """The belief after a candidate (k, n) is read."""
        gain = self.covariance @ block.T
        spread = np.eye(len(block)) + block @ gain
        covariance = self.covariance - gain @ np.linalg.solve(spread, gain.T)
        return dataclasses.replace(self, covariance=(covariance + covariance.T) / 2.0)

    def variances_after(self, blocks: Array) -> Array:
        """Variances (C, K) after each of the candidates (C, k, n) alone."""
        gain = blocks @ self.covariance
        spread = np.eye(blocks.shape[1]) + gain @ blocks.swapaxes(1, 2)
        count, rows, columns = gain.shape
        # A thousand systems of one equation are slow to solve as systems.
        white = (
            gain / np.sqrt(spread)
            if rows == 1
            else np.linalg.solve(np.linalg.cholesky(spread), gain)
        )
        flat = white.reshape(count * rows, columns)
        falls = [np.einsum("ij,ij->i", flat @ w, flat) for w in self.weights]
        fall = np.column_stack(falls).reshape(count, rows, -1).sum(axis=1)
        return np.asarray(self.variances - fall)

    def update_all(self, blocks: Array, indices: Sequence[int]) -> "Belief":
        """The belief after several candidates, in one update."""
        if not len(indices):
            return self
        columns = blocks.shape[2]
        return self.after(blocks[list(indices)].reshape(-1, columns))

    def open_components(self, limits: Array | None) -> list[int]:
        """Components whose standard deviation is above its limit; without limits, all."""
        if limits is None or not np.isfinite(limits).any():
            return list(range(len(self.weights)))
        missed = np.sqrt(self.variances) > np.where(np.isfinite(limits), limits, np.inf)
        return np.flatnonzero(missed).tolist()

    def best_candidate(self, blocks: Array, limits: Array | None = None) -> int:
        """The candidate (C, k, n) of least variances by limits (K,)."""
        return int(np.argmin(_scores(self.variances_after(blocks), limits)))

    def best_remaining(
        self, blocks: Array, count: int, limits: Array | None = None
    ) -> list[int]:
        """`count` candidates, planned together by exchange, the best by itself first.

        Each sweep replaces every reading by the best candidate given all others, and sweeps
        stop where nothing changes.
        """
        chosen: list[int] = []
        updated = self
        for _ in range(count):
            chosen.append(updated.best_candidate(blocks, limits))
            updated = updated.after(blocks[chosen[-1]])
        for _ in range(MAX_SWEEPS):
            before = list(chosen)
            for position in range(count):
                _exchange(self, blocks, chosen, position, limits)
            if chosen == before:
                break
        return _best_first(self, blocks, chosen, limits)

    def fewest_remaining(
        self, blocks: Array, most: int, limits: Array
    ) -> tuple[list[int], int] | None:
        """A plan for the fewest readings that reach all limits, and their number n.

        Best ones are added, then left out one by one while exchanges make up for it.
        The plan is the first that fails, of n - 1: what they show may make it suffice.
        None where `most` candidates do not reach the limits; empty where they are
        reached.
        """
        chosen: list[int] = []
        updated = self
        while updated.open_components(limits) and len(chosen) < most:
            chosen.append(updated.best_candidate(blocks, limits))
            updated = updated.after(blocks[chosen[-1]])
        if not _exchange_until_reached(self, blocks, chosen, limits):
            return None
        fewer = chosen
        while len(chosen) > 1:
            rests = [[*chosen[:k], *chosen[k + 1 :]] for k in range(len(chosen))]
            variances = [self.update_all(blocks, rest).variances for rest in rests]
            fewer = rests[int(np.argmin(_scores(np.array(variances), limits)))]
            if not _exchange_until_reached(self, blocks, fewer, limits):
                break
            chosen = fewer
        plan = _best_first(self, blocks, fewer, limits) if fewer else []
        return plan, len(chosen)


def _scores(variances: Array, limits: Array | None) -> Array:
    """Score (C,) of variances (C, K), the smaller the better: the sum of their logs.

    With limits, what a component lacks counts, and all logs a little: once all limits
    are reached, everything is improved.
    """
    logs = np.log(np.maximum(variances, np.finfo(float).tiny))
    total = logs.sum(axis=1)
    if limits is None or not np.isfinite(limits).any():
        return np.asarray(total)
    limited = np.isfinite(limits)
    lack = np.maximum(logs[:, limited] - 2.0 * np.log(limits[limited]), 0.0)
    return np.asarray(lack.sum(axis=1) + BEYOND_LIMITS_WEIGHT * total)


def _exchange(
    belief: Belief,
    blocks: Array,
    chosen: list[int],
    position: int,
    limits: Array | None,
) -> Belief:
    """Replace a chosen candidate by the best one given all others; what is then known."""
    others = [*chosen[:position], *chosen[position + 1 :]]
    updated = belief.update_all(blocks, others)
    chosen[position] = updated.best_candidate(blocks, limits)
    return updated.after(blocks[chosen[position]])


def _exchange_until_reached(
    belief: Belief, blocks: Array, chosen: list[int], limits: Array
) -> bool:
    """Exchange until all limits are reached; False where the sweeps do not suffice."""
    updated = belief.update_all(blocks, chosen)
    for _ in range(MAX_SWEEPS):
        for position in range(len(chosen)):
            if not updated.open_components(limits):
                return True
            updated = _exchange(belief, blocks, chosen, position, limits)
    return not updated.open_components(limits)


def _best_first(
    belief: Belief, blocks: Array, chosen: list[int], limits: Array | None
) -> list[int]:
    first = belief.best_candidate(blocks[chosen], limits)
    return [chosen[first], *chosen[:first], *chosen[first + 1 :]]
