"""Criteria of eigenvalues after a block is added: eigenvalues of the most promising
candidates only.

The rank is by what a block saves of tr M^-1, less the hurt to the largest eigenvalue
where that counts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oed.arrays import Array
from oed.design.criterion.variance import saved

#: candidates whose eigenvalues are computed
SHORTLIST = 24


def ranked(values: Array, vectors: Array, blocks: Array) -> Array:
    """What each block saves of tr M^-1 (C,), from eigenvalues and eigenvectors of M."""
    floor = np.maximum(values, 1e-9 * values[-1])
    return saved(
        blocks, (vectors / floor) @ vectors.T, (vectors / floor**2) @ vectors.T
    )


def spared(values: Array, vectors: Array, blocks: Array, share: float) -> Array:
    """As `ranked`, less the hurt of raising the eigenvalue known best."""
    floor = np.maximum(values, 1e-9 * values[-1])
    heavy = np.sum((blocks @ vectors[:, -1]) ** 2, axis=1) / values[-1]
    return np.asarray(
        np.log1p(ranked(values, vectors, blocks) / np.sum(1.0 / floor))
        - share * np.log1p(heavy)
    )


def exactly(
    of: Callable[[Array], Array], m: Array, blocks: Array, *ranks: Array
) -> Array:
    """of(eigenvalues of M + X_i^T X_i) (C,) for the candidates that lead one of the
    ranks (C,), -inf for the others.

    of maps (C, n) ascending eigenvalues to (C,).
    """
    most = max(SHORTLIST // len(ranks), 1)
    best = np.unique(
        np.concatenate([np.argsort(-r, kind="stable")[:most] for r in ranks])
    )
    joined = m + np.einsum("ckn,ckm->cnm", blocks[best], blocks[best], optimize=True)
    found = np.full(len(blocks), -np.inf)
    found[best] = of(np.asarray(np.linalg.eigvalsh(joined), dtype=float))
    return found
