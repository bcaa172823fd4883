"""Candidates as blocks X_i of k whitened, scaled rows with information X_i^T X_i."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oed.base import Array, Mask

#: rows beyond which a QR factorisation precedes the singular value decomposition
QR_ROWS = 20000
#: condition number of the rows from which an information matrix loses digits that a
#: certificate needs
ILL_CONDITION = 1e3
#: share of the largest singular value, a row or column, up to which one is rounding
RANK_TOLERANCE = float(np.finfo(float).eps)


def block_array(rows: Array) -> Array:
    """Candidates (C, n) or (C, k, n) as blocks (C, k, n).

    Raises ValueError for other shapes, and for numbers that are not finite.
    """
    blocks = rows[:, None, :] if rows.ndim == 2 else rows
    if blocks.ndim != 3 or not blocks.size:
        raise ValueError(
            "candidates must be rows (C, n) or blocks (C, k, n), not of shape"
            f" {rows.shape}"
        )
    finite = np.isfinite(blocks).all(axis=(1, 2))
    if not finite.all():
        first_bad = np.flatnonzero(~finite)[:5].tolist()
        raise ValueError(f"candidates number {first_bad} are not finite")
    return np.ascontiguousarray(blocks, dtype=float)


def information(blocks: Array, weights: Array | None = None) -> Array:
    """sum_i w_i X_i^T X_i (n, n)."""
    rows = blocks.reshape(-1, blocks.shape[2])
    if weights is None:
        return rows.T @ rows
    row_weights = np.repeat(weights, blocks.shape[1])[:, None]
    return (rows * row_weights).T @ rows


class Spectrum(NamedTuple):
    """Singular values (r,), largest first, and directions (n, r) of candidates and prior."""

    values: Array
    directions: Array

    def visible(self, tolerance: float) -> Mask:
        """Directions (r,) above the tolerance, a share of the largest."""
        return np.asarray(self.values > tolerance * self.values[0])

    def is_ill_conditioned(self, tolerance: float) -> bool:
        """Whether an information matrix of the visible directions would lose digits."""
        least = self.values[self.visible(tolerance)][-1]
        return bool(least * ILL_CONDITION < self.values[0])

    def weak(self, tolerance: float) -> int:
        """Number of directions that are not above the tolerance, and not rounding."""
        rounding = RANK_TOLERANCE * max(self.directions.shape)
        return int(np.sum(self.visible(rounding) & ~self.visible(tolerance)))


def spectrum(blocks: Array, prior: Array | None) -> Spectrum:
    """Singular values and directions of all rows, and of a root of the prior."""
    rows = blocks.reshape(-1, blocks.shape[2])
    if len(rows) > QR_ROWS:
        # part by part, so that no copy of all rows is in memory
        parts = np.array_split(rows, -(-len(rows) // QR_ROWS))
        rows = np.vstack([np.linalg.qr(part, mode="r") for part in parts])
    if prior is not None:
        rows = np.vstack([rows, _root(prior)])
    _, values, vt = np.linalg.svd(rows, full_matrices=False)
    return Spectrum(values, vt.T)


def project_on_estimable(
    blocks: Array, prior: Array | None, tolerance: float = 1e-6
) -> tuple[Array, Array]:
    """Blocks in an orthonormal basis (n, r) of the estimable subspace, and that basis.

    The subspace holds the directions that the candidates or the prior determine. No
    plan out of the candidates determines more, and determinants keep their value.
    """
    return project_orthonormal(blocks, spectrum(blocks, prior), tolerance)


def project_orthonormal(
    blocks: Array, of_all: Spectrum, tolerance: float
) -> tuple[Array, Array]:
    """Blocks in the directions above the tolerance, and these (n, r)."""
    basis = of_all.directions[:, of_all.visible(tolerance)]
    if basis.shape[1] == blocks.shape[2]:
        return blocks, np.eye(blocks.shape[2])
    return blocks @ basis, basis


def _root(matrix: Array) -> Array:
    """R (n, n) with R^T R = the positive semidefinite matrix."""
    eigenvalues, eigenvectors = np.linalg.eigh(matrix)
    return np.asarray(np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * eigenvectors.T)
