"""Exchange of blocks of readings for D: all pairs of a chosen and another block at once.

With D_ij = X_i M^-1 X_j^T, taking block i out and block j in multiplies det M by

    det(1 - D_ii) det(1 + D_jj + D_ji (1 - D_ii)^-1 D_ij),

Fedorov's formula (1972) for blocks. Where the plan without block i is nearly singular, the formula
loses digits. It only ranks the exchanges: one counts where the exact determinant rises.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import information

#: gain in log det below which an exchange counts as none
MIN_GAIN = 1e-9
#: exchanges at the most, a place
MAX_EXCHANGES = 100
#: eigenvalues of 1 - D_ii are raised to at least this
EIGENVALUE_FLOOR = 1e-12
#: numbers in the products of all pairs that are in memory at once
NUMBERS_AT_ONCE = 2_000_000


def exchange_blocks(blocks: Array, chosen: Index, base: Array) -> Index:
    """Exchanges the best pair of blocks (C, k, n) until none raises the determinant.

    base (n, n) is positive definite prior information, a small ridge at the least.
    """
    chosen = chosen.copy()
    m = base + information(blocks[chosen])
    value = float(np.linalg.slogdet(m)[1])
    for _ in range(MAX_EXCHANGES * len(chosen)):
        position, block = _best_pair(blocks, chosen, m)
        changed = chosen.copy()
        changed[position] = block
        m = base + information(blocks[changed])
        after = float(np.linalg.slogdet(m)[1])
        if not after > value + MIN_GAIN:
            break
        chosen, value = changed, after
    return chosen


def _best_pair(blocks: Array, chosen: Index, m: Array) -> tuple[int, int]:
    """Place and block whose exchange raises det M most, by the formula.

    Part by part, so that the products of all pairs are not in memory at once.
    """
    in_plan = np.zeros(len(blocks), dtype=bool)
    in_plan[chosen] = True
    best = 0, 0, -np.inf
    step = max(1, NUMBERS_AT_ONCE // (len(chosen) * blocks.shape[1] ** 2))
    leaving = _Leaving.of(blocks[chosen], m)
    for begin in range(0, len(blocks), step):
        part = slice(begin, begin + step)
        gains = leaving.log_gains(blocks[part])
        gains[:, in_plan[part]] = -np.inf
        position, block = divmod(int(gains.argmax()), gains.shape[1])
        if gains[position, block] > best[2]:
            best = position, begin + block, float(gains[position, block])
    return best[0], best[1]


def log_gains(blocks: Array, chosen: Index, m: Array) -> Array:
    """Gain (N, C) in log det of the plan with M (n, n) by each exchange."""
    return _Leaving.of(blocks[chosen], m).log_gains(blocks)


class _Leaving(NamedTuple):
    """The blocks of a plan, as each of them leaves.

    half        (n, n) H with H H^T = M^-1
    rows        (N k, n) of all (1 - D_ii)^(-1/2) X_i H
    log_shares  (N,) log det(1 - D_ii)
    """

    half: Array
    rows: Array
    log_shares: Array

    @classmethod
    def of(cls, chosen: Array, m: Array) -> _Leaving:
        """The blocks (N, k, n) of the plan with M (n, n)."""
        half = np.linalg.inv(np.linalg.cholesky(m)).T
        white = chosen @ half
        remaining = np.eye(chosen.shape[1]) - white @ np.swapaxes(white, 1, 2)
        shares, vectors = np.linalg.eigh(remaining)
        shares = np.maximum(shares, EIGENVALUE_FLOOR)
        roots = np.swapaxes(vectors, 1, 2) / np.sqrt(shares)[:, :, None]
        rows = (roots @ white).reshape(-1, len(m))
        return cls(half, rows, np.log(shares).sum(axis=1))

    def log_gains(self, blocks: Array) -> Array:
        """Gain (N, C) in log det where each of the blocks (C, k, n) comes."""
        _, k, n = blocks.shape
        coming = blocks.reshape(-1, n) @ self.half
        return self.log_shares[:, None] + _log_determinants(self.rows, coming, k)


def _log_determinants(scaled: Array, coming: Array, k: int) -> Array:
    """log det(1 + Z_j Z_j^T + G_ij^T G_ij) (N, C) with G_ij = S_i Z_j^T.

    scaled (N k, n) has the rows of all S_i, coming (C k, n) those of all Z_j.
    """
    count, n = len(coming) // k, coming.shape[1]
    cross = (scaled @ coming.T).reshape(-1, k, count, k)
    by_entry = np.ascontiguousarray(cross.transpose(1, 3, 0, 2))  # (k, k, N, C)
    z = coming.reshape(count, k, n)
    diagonal = (z @ np.swapaxes(z, 1, 2)).transpose(1, 2, 0) + np.eye(k)[:, :, None]
    matrix = np.empty_like(by_entry)
    for a in range(k):
        for b in range(a, k):
            products = np.einsum("inc,inc->nc", by_entry[:, a], by_entry[:, b])
            matrix[b, a] = products + diagonal[b, a]
    return _log_determinants_by_entry(matrix)


def _log_determinants_by_entry(matrix: Array) -> Array:
    """Log determinants (N, C) of positive definite matrices (k, k, N, C).

    By elimination in place; only the lower triangle is read.
    """
    k = len(matrix)
    product = matrix[0, 0].copy()
    for pivot in range(k - 1):
        quotients = matrix[pivot + 1 :, pivot] / matrix[pivot, pivot]
        for row in range(pivot + 1, k):
            columns = slice(pivot + 1, row + 1)
            update = quotients[row - pivot - 1] * matrix[columns, pivot]
            matrix[row, columns] -= update
        product *= matrix[pivot + 1, pivot + 1]
    return np.asarray(np.log(np.maximum(product, 1e-300)))
