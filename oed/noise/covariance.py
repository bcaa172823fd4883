"""Noise of readings: independent, correlated within a reading, or shared by a run.

A reading's channels may be correlated (a gimbal's angles turned into Cartesian
coordinates), and the readings of a run may share an error (the reference reading that
all of them are differences from). Then the covariance has a root in linear time
(`oed.noise.factor`).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.noise.factor import Errors, LinearFactor, WideFactor, joined


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of N readings, SI: independent here, related in other classes."""

    sigma: Array  #: (N,) marginal standard deviations

    @staticmethod
    def of(noise: "Noise | Array") -> "Noise":
        """Standard deviations (N,) as independent noise; a Noise as it is."""
        if isinstance(noise, Noise):
            return noise
        return Noise(np.asarray(noise, dtype=float))

    @property
    def is_independent(self) -> bool:
        """Whether all readings are independent."""
        return type(self) is Noise

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        return values / self.sigma.reshape(-1, *[1] * (values.ndim - 1))

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        return values / self.sigma.reshape(-1, *[1] * (values.ndim - 1))

    def precision(self, values: Array) -> Array:
        """Sigma^-1 Y, for Y (N,) or (N, n)."""
        return self.whiten_back(self.whiten(values))

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1."""
        return np.asarray(1.0 / self.sigma**2)

    def whiten_last(self, values: Array) -> Array:
        """Whitened values (..., N), with readings last."""
        flat = values.reshape(-1, values.shape[-1])
        return self.whiten(flat.T).T.reshape(values.shape)

    def scaled(self, factor: float) -> "Noise":
        """The same noise times a factor."""
        return self if factor == 1.0 else Noise(self.sigma * factor)

    def split_common(self) -> "tuple[Noise, Array]":
        """Noise independent between runs, and what all share (N, k), SI."""
        return self, np.zeros((len(self.sigma), 0))

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        return self.correlate(rng.standard_normal(shape))

    def correlate(self, white: Array) -> Array:
        """Errors (..., N) of white ones."""
        return self.sigma * white


@dataclasses.dataclass(frozen=True)
class FactoredNoise(Noise):
    """Noise of readings that are related within runs; SI."""

    #: of the covariance
    factor: LinearFactor | WideFactor = dataclasses.field(kw_only=True)

    @classmethod
    def of_errors(cls, sigma: Array, parts: Sequence[Errors]) -> "FactoredNoise":
        """Noise of readings whose errors follow one another, sets apart independent."""
        return cls(sigma, factor=LinearFactor(joined(parts)))

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        wide = values[:, None] if values.ndim == 1 else values
        white = np.empty(wide.shape)
        white[self.factor.order] = self.factor.whiten(wide)
        return white.reshape(values.shape)

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        wide = values[:, None] if values.ndim == 1 else values
        return self.factor.whiten_back(wide[self.factor.order]).reshape(values.shape)

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1."""
        return self.factor.precision_diagonal()

    def scaled(self, factor: float) -> Noise:
        """The same noise times a factor."""
        return FactoredNoise(self.sigma * factor, factor=self.factor.scaled(factor))

    def correlate(self, white: Array) -> Array:
        """Errors (..., N) of white ones, as by Cholesky's root of each run."""
        if isinstance(self.factor, WideFactor):
            raise TypeError("errors with effects are drawn by their law")
        flat = white.reshape(-1, white.shape[-1])
        errors = np.empty_like(flat)
        order = self.factor.order
        errors[:, order] = self.factor.correlate(flat[:, order].T).T
        return errors.reshape(white.shape)
