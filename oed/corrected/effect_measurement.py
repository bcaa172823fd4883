"""A measurement whose parameters include the coefficients of effects.

About a linearisation point (theta_0, beta_0) the readings are

    y(theta, beta) = f(theta) + G beta + c,    c = y_exact(theta_0, beta_0) - f(theta_0) - G beta_0,

with G the effects' signature (`oed.gap.data.signature`). They are exact at that point;
estimation moves the point to its result.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.measurement import Measurement, Series
from oed.model.machine import Parameter
from oed.model.series import TakenReadings

#: name of a coefficient in theta: `effect: coefficient`
SEPARATOR = ": "


class MeasurementWithEffects(Measurement):
    """A measurement of fixed series with coefficients beta (k,) at the end of theta.

    base     the measurement without effects; its compiled functions are shared
    series   all readings, in their order
    names    (k,) of the coefficients, `effect: coefficient`
    sizes    (k,) prior standard deviations of beta
    columns  (N, k) G, SI
    offset   (N,) c, SI
    """

    def __init__(
        self,
        base: Measurement,
        series: Sequence[Series],
        names: Sequence[str],
        sizes: Array,
        columns: Array,
        offset: Array,
    ) -> None:
        self.__dict__.update(base.__dict__)
        coefficients = [
            Parameter(name, 0.0, float(size), "1")
            for name, size in zip(names, sizes, strict=True)
        ]
        self.parameters = (*base.parameters, *coefficients)
        self._size = len(base.parameters)
        self._lengths = np.sqrt(np.mean(columns**2, axis=0)) * sizes
        self._series = tuple(series)
        self._columns, self._offset = {}, {}
        start = 0
        for s in self._series:
            stop = start + len(s) * len(base.setups[s.setup].sigma)
            self._columns[id(s.q)] = columns[start:stop]
            self._offset[id(s.q)] = offset[start:stop]
            start = stop

    @property
    def length_factors(self) -> Array:
        """Factor (n,) that turns each entry into a length, m.

        That of a coefficient is its root mean square change of the readings.
        """
        machine_and_setups = super().length_factors[: self._size]
        return np.concatenate([machine_and_setups, self._lengths])

    def _read_at(self, series: Series, x: Array, theta: Array) -> Array:
        """Readings (m, N of the series) at poses x (m, poses, nx) and theta (m, n)."""
        y = super()._read_at(series, x, theta)
        change = theta[:, self._size :] @ self._columns[id(series.q)].T
        return y + change + self._offset[id(series.q)]

    def _jacobian(self, series: Series, theta: Array) -> Array:
        rows = super()._jacobian(series, theta)
        rows[..., self._size :] = self._columns[id(series.q)]
        return rows

    def of_taken(self, taken: Sequence[TakenReadings]) -> MeasurementWithEffects:
        """The measurement of series that have some readings of its own."""
        measurement = copy.copy(self)
        measurement._series = tuple(some.part for some in taken)
        measurement._columns, measurement._offset = {}, {}
        for some in taken:
            whole, part = id(some.whole.q), id(some.part.q)
            channels = np.arange(len(self.setups[some.whole.setup].sigma))
            values = (some.rows[:, None] * len(channels) + channels).ravel()
            measurement._columns[part] = self._columns[whole][values]
            measurement._offset[part] = self._offset[whole][values]
        return measurement
