"""Exchange of rows written by hand in NumPy: a greedy plan and random plans, improved.

Pairs of rows by Fedorov's formula for D; each candidate in turn for blocks, and for A and I.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: condition number beyond which an information matrix counts as singular
MAX_CONDITION = 1e12
GAIN = 1e-9  #: relative gain in the determinant below which an exchange counts as none


def log_det(blocks: np.ndarray, chosen: np.ndarray) -> float:
    """Value of a plan, from the singular values of its rows."""
    rows = blocks[chosen].reshape(-1, blocks.shape[2])
    with np.errstate(divide="ignore"):
        return 2.0 * float(np.log(np.linalg.svd(rows, compute_uv=False)).sum())


def select_greedily(blocks: np.ndarray, size: int) -> np.ndarray:
    """Candidates added one by one, each the one that raises the determinant most."""
    count, k, columns = blocks.shape
    m = 1e-6 * float(np.mean(blocks**2)) * np.eye(columns)
    allowed, chosen = np.ones(count, dtype=bool), []
    for _ in range(size):
        factors = np.linalg.det(np.eye(k) + blocks @ np.linalg.inv(m) @ blocks.mT)
        best = int(np.argmax(np.where(allowed, factors, -np.inf)))
        chosen.append(best)
        allowed[best] = False
        m = m + blocks[best].T @ blocks[best]
    return np.array(chosen)


def exchange_rows(rows: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Best pair of rows (C, n) exchanged until none raises the determinant."""
    chosen = chosen.copy()
    while True:
        side = rows @ np.linalg.inv(rows[chosen].T @ rows[chosen])
        leverage = np.sum(side * rows, axis=1)
        factors = (side[chosen] @ rows.T) ** 2
        factors += np.outer(1.0 - leverage[chosen], 1.0 + leverage)
        factors[:, chosen] = 0.0
        place, row = divmod(int(factors.argmax()), len(rows))
        if not factors[place, row] > 1.0 + GAIN:
            return chosen
        chosen[place] = row


def variance(rows: np.ndarray, chosen: np.ndarray, weight: np.ndarray) -> float:
    """tr(W M^-1) of a plan out of rows (C, n); infinite where it is singular."""
    m = rows[chosen].T @ rows[chosen]
    if np.linalg.cond(m) > MAX_CONDITION:
        return np.inf
    return float(np.trace(weight @ np.linalg.inv(m)))


def exchange_in_turn(
    chosen: np.ndarray, scores: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Each candidate in turn replaced by the best one until none helps.

    scores  positive score (C,) of each candidate beside the others of the plan
    """
    chosen, changed = chosen.copy(), True
    while changed:
        changed = False
        for place in range(len(chosen)):
            others = np.delete(chosen, place)
            score = scores(others)
            before = score[chosen[place]]
            score[others] = -np.inf
            best = int(np.argmax(score))
            if score[best] > before * (1.0 + GAIN):
                chosen[place], changed = best, True
    return chosen


def exchange_blocks(blocks: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Blocks (C, k, n) exchanged in turn until none raises the determinant."""
    k, columns = blocks.shape[1:]

    def factors(others: np.ndarray) -> np.ndarray:
        rows = blocks[others].reshape(-1, columns)
        ridge = 1e-12 * float(np.mean(rows**2)) * np.eye(columns)
        inverse = np.linalg.inv(rows.T @ rows + ridge)
        return np.linalg.det(np.eye(k) + blocks @ inverse @ blocks.mT)

    return exchange_in_turn(chosen, factors)


def exchange_by_variance(
    rows: np.ndarray, chosen: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Rows (C, n) exchanged in turn until none lowers tr(W M^-1)."""
    ridge = 1e-10 * np.eye(rows.shape[1])

    def reductions(others: np.ndarray) -> np.ndarray:
        inverse = np.linalg.inv(rows[others].T @ rows[others] + ridge)
        side = rows @ inverse
        reduction = np.sum((side @ weight) * side, axis=1)
        return reduction / (1.0 + np.sum(side * rows, axis=1))

    return exchange_in_turn(chosen, reductions)


def exchange(
    blocks: np.ndarray,
    size: int,
    starts: int,
    rng: np.random.Generator,
    weight: np.ndarray | None = None,
) -> np.ndarray:
    """The best plan of a greedy start and of `starts` random ones; blocks (C, k, n).

    By log det, or, of single rows, by tr(W M^-1) with a `weight` W (n, n).
    """
    plans = [select_greedily(blocks, size)]
    plans += [rng.permutation(len(blocks))[:size] for _ in range(starts)]
    if weight is not None:
        rows = blocks[:, 0]
        plans = [exchange_by_variance(rows, plan, weight) for plan in plans]
        return min(plans, key=lambda plan: variance(rows, plan, weight))
    if blocks.shape[1] == 1:
        plans = [exchange_rows(blocks[:, 0], plan) for plan in plans]
    else:
        plans = [exchange_blocks(blocks, plan) for plan in plans]
    return max(plans, key=lambda plan: log_det(blocks, plan))
