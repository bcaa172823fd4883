"""Noise of readings: independent, correlated within a reading, or shared by a run.

A reading's channels may be correlated (a gimbal's angles turned into Cartesian
coordinates), and the readings of a run may share an error (the reference reading that
all of them are differences from). The covariance is block diagonal over runs; W with W
Sigma W^T = 1 is kept as a sparse matrix, so that whitening costs what the blocks cost,
and that of long runs as a factor in linear time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse

from oed.base.arrays import Array, Index
from oed.noise.factor import LinearFactor


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

    @property
    def is_independent(self) -> bool:
        """Whether all readings are independent; noises of other classes relate them."""
        return type(self) is Noise and self.whitening is None

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        if self.whitening is not None:
            return np.asarray(self.whitening @ values)
        return values / self.sigma.reshape(-1, *[1] * (values.ndim - 1))

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        if self.whitening is not None:
            return np.asarray(self.whitening.T @ values)
        return values / self.sigma.reshape(-1, *[1] * (values.ndim - 1))

    def precision(self, values: Array) -> Array:
        """Sigma^-1 Y, for Y (N,) or (N, n)."""
        return self.whiten_back(self.whiten(values))

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1."""
        if self.whitening is not None:
            return np.asarray(self.whitening.power(2).sum(axis=0)).ravel()
        return np.asarray(1.0 / self.sigma**2)

    def whiten_last(self, values: Array) -> Array:
        """Whitened values (..., N), with readings last."""
        flat = values.reshape(-1, values.shape[-1])
        return self.whiten(flat.T).T.reshape(values.shape)

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

    def of_runs(self) -> tuple[Noise, Array]:
        """Noise that is independent between runs, and what all readings share beside it.

        The latter as columns (N, k), SI, per standard deviation of each.
        """
        return self, np.zeros((len(self.sigma), 0))

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        return self.correlate(rng.standard_normal(shape))

    def correlate(self, white: Array) -> Array:
        """Errors (..., N) of white ones."""
        if self.root is None:
            return self.sigma * white
        return np.asarray((self.root @ white.T).T)


def as_noise(noise: Noise | Array) -> Noise:
    """Standard deviations (N,) as independent noise; a Noise as it is."""
    return noise if isinstance(noise, Noise) else Noise(np.asarray(noise, dtype=float))


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
    if any(isinstance(p, FactoredNoise) for p in parts):
        return SeveralNoises(np.concatenate([p.sigma for p in parts]), parts=parts)
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


@dataclasses.dataclass(frozen=True)
class FactoredNoise(Noise):
    """Noise of readings in long runs, by a factor in linear time; SI.

    factor  of the covariance
    """

    factor: LinearFactor = dataclasses.field(kw_only=True)

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        wide = values[:, None] if values.ndim == 1 else values
        return self.factor.whiten_in_place(wide).reshape(values.shape)

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        wide = values[:, None] if values.ndim == 1 else values
        return self.factor.whiten_back(wide[self.factor.order]).reshape(values.shape)

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1."""
        return self.factor.precision_diagonal()

    def scaled(self, factor: Array) -> Noise:
        """The same noise times a factor (N,), equal within each run."""
        errors = self.factor.errors
        scale = errors.scale * factor[errors.order]
        changed = LinearFactor(dataclasses.replace(errors, scale=scale))
        return FactoredNoise(self.sigma * factor, factor=changed)

    def correlate(self, white: Array) -> Array:
        """Errors (..., N) of white ones, as by Cholesky's root of each run."""
        flat = white.reshape(-1, white.shape[-1])
        errors = np.empty_like(flat)
        order = self.factor.order
        errors[:, order] = self.factor.correlate(flat[:, order].T).T
        return errors.reshape(white.shape)


@dataclasses.dataclass(frozen=True)
class SeveralNoises(Noise):
    """Noise of readings one after the other, of which some are in long runs."""

    parts: Sequence[Noise] = dataclasses.field(kw_only=True)

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        return self._by_part(values, lambda noise, part: noise.whiten(part))

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        return self._by_part(values, lambda noise, part: noise.whiten_back(part))

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1."""
        return np.concatenate([p.precision_diagonal() for p in self.parts])

    def scaled(self, factor: Array) -> Noise:
        """The same noise times a factor (N,), equal within each run."""
        pairs = zip(self.parts, np.split(factor, self._ends), strict=True)
        return concatenate_noise([noise.scaled(f) for noise, f in pairs])

    def correlate(self, white: Array) -> Array:
        """Errors (..., N) of white ones."""
        moved = np.moveaxis(white, -1, 0)
        errors = self._by_part(
            moved,
            lambda noise, part: np.moveaxis(
                noise.correlate(np.moveaxis(part, 0, -1)), -1, 0
            ),
        )
        return np.moveaxis(errors, 0, -1)

    @property
    def _ends(self) -> Index:
        return np.cumsum([len(p.sigma) for p in self.parts])[:-1]

    def _by_part(self, values: Array, change: Callable[[Noise, Array], Array]) -> Array:
        pairs = zip(self.parts, np.split(values, self._ends), strict=True)
        return np.concatenate([change(noise, part) for noise, part in pairs])
