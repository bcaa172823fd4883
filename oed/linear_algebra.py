"""Matrix functions that several modules share."""

from __future__ import annotations

import numpy as np

from oed.arrays import Array


def right_singular(matrix: Array) -> tuple[Array, Array]:
    """Singular values (n,) of a matrix (N, n), and all right singular vectors (n, n).

    The vectors are rows, those of the null space last; missing singular values are 0.
    No square of the N rows is formed.
    """
    rows, n = matrix.shape
    _, values, vectors = np.linalg.svd(matrix, full_matrices=rows < n)
    padded = np.zeros(n)
    padded[: values.size] = values
    return padded, vectors


def covariance_root(covariance: Array) -> Array:
    """Root R with R R^T = C of covariances C (..., n, n), by their eigenvectors.

    Eigenvalues that rounding made negative count as 0, so that C may be singular.
    """
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])
