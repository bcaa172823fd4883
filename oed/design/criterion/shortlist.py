"""Eigenvalue criteria after adding a block, computed for a shortlist of candidates.

A candidate's rank is its reduction of tr M^-1. Where the largest eigenvalue counts, a
second rank takes off the rise of that eigenvalue.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oed.base.arrays import Array
from oed.design.criterion.variance import variance_reduction

#: candidates whose eigenvalues are computed
SHORTLIST = 24
#: eigenvalues are raised to at least this share of the largest
FLOOR = 1e-9


def rank_by_variance(eigenvalues: Array, eigenvectors: Array, blocks: Array) -> Array:
    """Reduction of tr M^-1 by each block (C,), from the eigensystem of M."""
    floored = np.maximum(eigenvalues, FLOOR * eigenvalues[-1])
    inverted = (eigenvectors / floored) @ eigenvectors.T
    squared = (eigenvectors / floored**2) @ eigenvectors.T
    return variance_reduction(blocks, inverted, squared)


def rank_by_spread(
    eigenvalues: Array, eigenvectors: Array, blocks: Array, share: float
) -> Array:
    """As `rank_by_variance`, less a share of the rise of the largest eigenvalue."""
    floored = np.maximum(eigenvalues, FLOOR * eigenvalues[-1])
    along_largest = np.sum((blocks @ eigenvectors[:, -1]) ** 2, axis=1)
    reduction = rank_by_variance(eigenvalues, eigenvectors, blocks)
    gain = np.log1p(reduction / np.sum(1.0 / floored))
    return np.asarray(gain - share * np.log1p(along_largest / eigenvalues[-1]))


def evaluate_shortlist(
    of_eigenvalues: Callable[[Array], Array], m: Array, blocks: Array, *ranks: Array
) -> Array:
    """A function of the eigenvalues of M + X_i^T X_i (C,); -inf off the shortlist.

    The shortlist holds the first candidates by each of the ranks (C,). of_eigenvalues
    maps ascending eigenvalues (C, n) to values (C,).
    """
    places = max(SHORTLIST // len(ranks), 1)
    first = [np.argsort(-rank, kind="stable")[:places] for rank in ranks]
    shortlist = np.unique(np.concatenate(first))
    added = blocks[shortlist]
    sums = m + np.einsum("ckn,ckm->cnm", added, added)
    values = np.full(len(blocks), -np.inf)
    eigenvalues = np.asarray(np.linalg.eigvalsh(sums), dtype=float)
    values[shortlist] = of_eigenvalues(eigenvalues)
    return values
