"""Readings of machines at the same poses as a problem of the fitter."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.estimation.fitter import READINGS_ROUNDED
from oed.measurement.measurement import Measurement, Series
from oed.noise.covariance import Noise


@dataclasses.dataclass(frozen=True, eq=False)
class ReadingsProblem:
    """Readings of m machines over z: theta = origin + basis @ z.

    y       (m, N) readings, SI
    origin  (m, n) parameters at z = 0, SI
    basis   (n, k) changes of the parameters, SI, per z
    """

    measurement: Measurement
    series: Sequence[Series]
    noise: Noise
    y: Array
    origin: Array
    basis: Array

    @functools.cached_property
    def rounding(self) -> Array:
        """Rounding errors (m, N) of the whitened residuals."""
        # a small reading may be the difference of lengths as large as the machine
        factors = self.measurement.reading_length_factors(self.series)
        size = np.maximum(np.abs(self.y), self.measurement.machine.lever / factors)
        # whitening divides by what the other errors leave of each one
        return READINGS_ROUNDED * size * np.sqrt(self.noise.precision_diagonal())

    def theta(self, machines: Index, z: Array) -> Array:
        """Parameters (s, n), SI, of some machines at z (s, k)."""
        return self.origin[machines] + z @ self.basis.T

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (s, N); NaN where a pose cannot be assembled."""
        theta = self.theta(machines, z)
        predicted = self.measurement.try_readings(self.series, theta)
        return self.noise.whiten_last(self.y[machines] - predicted)

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened slopes (s, N, k). Raises AssemblyError."""
        rows = self.measurement.jacobian(self.series, self.theta(machines, z))
        over_z = rows @ self.basis
        by_reading = over_z.swapaxes(0, 1).reshape(over_z.shape[1], -1)
        white = self.noise.whiten(by_reading)
        return white.reshape(over_z.shape[1], len(machines), -1).swapaxes(0, 1)
