"""Matrix functions that several modules share, with results that no library decides.

A singular vector or eigenvector has any sign, and vectors of equal values are turned in
their space at will: one library returns others than the next, or the same on another
processor. What is drawn along them would differ with them. So every basis here is the
one that fixed directions choose, and roots of covariances are those that are unique.
"""

import functools
import itertools
from typing import Final

import numpy as np

from oed.base import Array, Index

#: relative difference of values up to which their vectors count as one space
EQUAL_VALUE_TOLERANCE: Final = 1e-7
#: share of the largest value below which a value is rounding
ZERO_VALUE_SHARE: Final = 1e-13
DIRECTION_SEED: Final = 20160801  #: seed of the directions that choose signs and turns


def right_singular(matrix: Array) -> tuple[Array, Array]:
    """Singular values (n,) of a matrix (N, n), and all right singular vectors (n, n).

    The vectors are rows, those of the null space last. Singular values that are missing,
    or rounding, are 0. No square of the N rows is formed.
    """
    rows, n = matrix.shape
    _, values, vectors = np.linalg.svd(matrix, full_matrices=rows < n)
    rounding = max(rows, n) * np.finfo(float).eps * values.max(initial=0.0)
    padded = np.zeros(n)
    padded[: values.size] = np.where(values > rounding, values, 0.0)
    return padded, canonical_rows(vectors, padded)


def eigenvectors(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues (n,), ascending, and eigenvectors (n, n), as columns."""
    values, vectors = np.linalg.eigh(matrix)
    return values, canonical_rows(vectors.T, values).T


def canonical_rows(vectors: Array, values: Array | None = None) -> Array:
    """Orthonormal rows (k, n), one for each group of equal monotonic values (k,)."""
    count, n = vectors.shape
    if values is None:
        values = np.ones(count)
    chosen = vectors.copy()
    ends = [0, *_new_groups(values[:count]), count]
    alone = np.flatnonzero(np.diff(ends) == 1)
    rows = np.array(ends)[alone]
    against = vectors[rows] @ _fixed_directions(n, 1)[:, 0] < 0.0
    chosen[rows[against]] *= -1.0
    for first, stop in itertools.pairwise(ends):
        if stop - first > 1:
            space = vectors[first:stop]  # along the fixed directions, projected
            turn, triangle = np.linalg.qr(space @ _fixed_directions(n, len(space)))
            signs = np.where(np.diag(triangle) < 0.0, -1.0, 1.0)
            chosen[first:stop] = (turn * signs).T @ space
    return chosen


def _new_groups(values: Array) -> list[int]:
    """Numbers of the values, from 1, that differ from the one before."""
    if len(values) < 2:
        return []
    size = np.maximum(np.abs(values[1:]), np.abs(values[:-1]))
    rounding = ZERO_VALUE_SHARE * np.abs(values).max()
    differs = np.abs(np.diff(values)) > np.maximum(
        EQUAL_VALUE_TOLERANCE * size, rounding
    )
    return [int(k) + 1 for k in np.flatnonzero(differs)]


@functools.lru_cache(maxsize=64)
def _fixed_directions(n: int, count: int) -> Array:
    return np.random.default_rng(DIRECTION_SEED).standard_normal((n, count))


def first_largest(values: Array) -> int:
    """Number of the entry of largest size; of equal ones, but for rounding, the first."""
    sizes = np.abs(values)
    return int(np.argmax(sizes >= (1.0 - EQUAL_VALUE_TOLERANCE) * sizes.max()))


def size_order(values: Array) -> Index:
    """Numbers of the entries, the largest size first; equal ones, but for rounding, in
    their order.
    """
    sizes = np.abs(values)
    largest = sizes.max(initial=0.0)
    return np.argsort(-(sizes / (largest or 1.0)).round(7), kind="stable")


def covariance_root(covariance: Array) -> Array:
    """Root R with R R^T = C of covariances C (..., n, n): the only one of its kind.

    R = D S with D the standard deviations and S the symmetric root of the correlation.
    C may be singular.
    """
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    sd = np.sqrt(np.maximum(variance, 0.0))
    scale = np.where(sd > 0.0, sd, 1.0)
    correlation = covariance / (scale[..., :, None] * scale[..., None, :])
    # sd, not scale: what has no variance stays where it is
    return sd[..., :, None] * symmetric_root(correlation)


def precision_root(precision: Array) -> Array:
    """Upper triangular R with R R^T = P^-1 of precisions P (..., n, n), which keeps
    what a computed covariance would lose: what P determines 1e8 times better.
    """
    triangle = np.linalg.inv(triangle_of_sums(precision))
    return np.asarray(np.triu(np.swapaxes(triangle, -1, -2)))


def triangle_of_sums(sums: Array) -> Array:
    """Cholesky factor of sums of squares (..., n, n), exact to rounding of the diagonal."""
    n = sums.shape[-1]
    rounded = sums * (1.0 + n * np.finfo(float).eps * np.eye(n))
    return np.asarray(np.linalg.cholesky(rounded))


def symmetric_root(matrix: Array) -> Array:
    """Symmetric S, S S = M (..., n, n) semidefinite; rounding counts as 0."""
    values, vectors = np.linalg.eigh(matrix)
    n = matrix.shape[-1]
    rounding = n * np.finfo(float).eps * np.abs(values).max(axis=-1, keepdims=True)
    sizes = np.sqrt(np.where(values > rounding, values, 0.0))
    scaled = vectors * sizes[..., None, :]
    return np.asarray(scaled @ np.swapaxes(vectors, -1, -2))


def explained_energy(
    values: Array, squares: Array, variances: Array
) -> tuple[Array, Array]:
    """What columns with normal coefficients explain of a residual, by their variance.

    values     (..., d) eigenvalues of the columns' Gram matrix A
    squares    (..., d) squared components of the residual's projections b along them
    variances  (S,) t^2 of the coefficients

    The results (..., S) are b^T (1 / t^2 + A)^-1 b and log |1 + t^2 A|. Twice the log
    evidence of the columns over none is their difference, in units of the noise.
    """
    variance = variances[:, None]
    inflation = 1.0 + values[..., None, :] * variance
    gain = np.einsum("...sd,...d->...s", variance / inflation, squares)
    return gain, np.log(inflation).sum(axis=-1)


def symmetric_inverse(m: Array) -> Array:
    """Inverse of a symmetric matrix (n, n), made exactly symmetric."""
    inverted = np.linalg.inv(m)
    return 0.5 * (inverted + inverted.T)
