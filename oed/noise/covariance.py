"""Noise of readings: independent, correlated within a reading, or shared by a run.

A reading's channels may be correlated (a gimbal's angles turned into Cartesian
coordinates), and the readings of a run may share an error (the reference reading that
all of them are told against). The covariance is block diagonal over runs; W with W
Sigma W^T = 1 is kept as a sparse matrix, so that whitening costs what the blocks cost.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import sparse

from oed.arrays import Array, Index


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of N readings, SI.

    sigma  (N,) marginal standard deviations
    white  (N, N) sparse W with W Sigma W^T = 1;  root (N, N) sparse R with R R^T =
           Sigma
    None for both where all readings are independent.
    """

    sigma: Array
    whitening: sparse.csr_array | None = None
    root: sparse.csr_array | None = None

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        if self.whitening is not None:
            return np.asarray(self.whitening @ values)
        return values / self.sigma.reshape(-1, *[1] * (values.ndim - 1))

    def whiten_last(self, values: Array) -> Array:
        """Whitened values (..., N), with readings last."""
        return (
            values / self.sigma
            if self.whitening is None
            else np.asarray((self.whitening @ values.T).T)
        )

    def scaled(self, factor: Array) -> Noise:
        """The same noise times a factor (N,), equal within each run."""
        if self.whitening is None or self.root is None:
            return Noise(self.sigma * factor)
        white, root = (
            self.whitening @ sparse.diags_array(1.0 / factor),
            sparse.diags_array(factor) @ self.root,
        )
        return Noise(
            self.sigma * factor, sparse.csr_array(white), sparse.csr_array(root)
        )

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        e = rng.standard_normal(shape)
        return self.sigma * e if self.root is None else np.asarray((self.root @ e.T).T)


def as_noise(noise: Noise | Array) -> Noise:
    """Standard deviations (N,) as independent noise; a Noise as it is."""
    return noise if isinstance(noise, Noise) else Noise(np.asarray(noise, dtype=float))


def independent_noise(sigma: Array) -> Noise:
    """Independent readings with standard deviations (N,)."""
    return Noise(sigma)


def block_noise(
    covariances: Sequence[Array] | Array, places: Sequence[Index] | Index
) -> Noise:
    """Noise with dense covariance blocks at index sets `places`, which together cover
    all readings.
    """
    n = sum(len(p) for p in places)
    sigma = np.zeros(n)
    rows, columns = [], []
    white: list[Array] = []
    root: list[Array] = []
    for covariance, place in zip(covariances, places, strict=True):
        factor = np.linalg.cholesky(covariance)
        sigma[place] = np.sqrt(np.diag(covariance))
        rows.append(np.repeat(place, len(place)))
        columns.append(np.tile(place, len(place)))
        white.append(np.asarray(np.linalg.inv(factor), dtype=float).ravel())
        root.append(np.asarray(factor, dtype=float).ravel())
    at = (np.concatenate(rows), np.concatenate(columns))

    def as_matrix(values: list[Array]) -> sparse.csr_array:
        return sparse.csr_array(
            sparse.coo_array((np.concatenate(values), at), shape=(n, n))
        )

    return Noise(sigma, as_matrix(white), as_matrix(root))


def concatenate_noise(parts: Sequence[Noise]) -> Noise:
    """Noise of readings one after the other."""
    sigma = np.concatenate([p.sigma for p in parts])
    if all(p.whitening is None for p in parts):
        return Noise(sigma)
    white = [
        p.whitening if p.whitening is not None else sparse.diags_array(1.0 / p.sigma)
        for p in parts
    ]
    root = [
        p.root if p.root is not None else sparse.diags_array(p.sigma) for p in parts
    ]
    return Noise(
        sigma,
        sparse.csr_array(sparse.block_diag(white)),
        sparse.csr_array(sparse.block_diag(root)),
    )
