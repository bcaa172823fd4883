"""Candidates as blocks: each candidate i is a block X_i of k whitened, scaled rows,
with information X_i^T X_i.
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array


def as_blocks(rows: Array) -> Array:
    """Candidates (C, n) or (C, k, n) as blocks (C, k, n); raises ValueError for
    anything else or not finite.
    """
    blocks = rows[:, None, :] if rows.ndim == 2 else rows
    if blocks.ndim != 3 or not blocks.size:
        raise ValueError(
            "candidates must be rows (C, n) or blocks (C, k, n), not of shape"
            f" {rows.shape}"
        )
    if not np.isfinite(blocks).all():
        bad = np.flatnonzero(~np.isfinite(blocks).all(axis=(1, 2)))
        raise ValueError(f"candidates number {bad[:5].tolist()} are not finite")
    return np.ascontiguousarray(blocks, dtype=float)


def information(blocks: Array, weights: Array | None = None) -> Array:
    """sum_i w_i X_i^T X_i (n, n)."""
    flat = blocks.reshape(-1, blocks.shape[2])
    if weights is None:
        return np.asarray(flat.T @ flat)
    return np.asarray((flat * np.repeat(weights, blocks.shape[1])[:, None]).T @ flat)


def gradient(blocks: Array, information: Array) -> Array:
    """tr(M^-1 X_i^T X_i) of each candidate (C,): the slope of log det M along its
    weight.
    """
    white = whitened(blocks, information)
    return np.asarray(np.einsum("ckn,ckn->c", white, white))


def whitened(blocks: Array, information: Array) -> Array:
    """Blocks X_i L^-T (C, k, n) with M = L L^T. Raises numpy's LinAlgError where M is
    singular.
    """
    root = np.linalg.inv(np.linalg.cholesky(information))
    return np.asarray(
        (blocks.reshape(-1, blocks.shape[2]) @ root.T).reshape(blocks.shape)
    )


def seen(
    blocks: Array, prior: Array | None, tolerance: float = 1e-6
) -> tuple[Array, Array]:
    """Blocks in an orthonormal basis (n, r) of the directions that candidates or prior
    see, and that basis.

    Determinants over these directions keep their value. No plan out of the candidates
    sees more.
    """
    flat = blocks.reshape(-1, blocks.shape[2])
    if len(flat) > 20000:
        flat = np.asarray(np.linalg.qr(flat, mode="r"), dtype=float)
    if prior is not None:
        values, vectors = np.linalg.eigh(prior)
        held = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        flat = np.vstack([flat, held])
    _, s, vt = np.linalg.svd(flat, full_matrices=False)
    basis = vt[s > tolerance * s[0]].T
    if basis.shape[1] == blocks.shape[2]:
        return blocks, np.eye(blocks.shape[2])
    return blocks @ basis, basis
