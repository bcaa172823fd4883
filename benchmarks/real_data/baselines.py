"""What nominal numbers and plain least squares leave of readings that they did not see.

Plain least squares is that of SciPy: the same parameters, readings over their stated
noise, no tolerances, from nominal. Of held-out readings each set-up's own unknowns are
adjusted, also without tolerances, for both.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from oed import units
from oed.base import Array, Mask
from oed.dataset import Dataset
from oed.measurement import Measurement, Series

#: (set-up, channel): rms in its fine unit
Figures = dict[tuple[str, str], float]


def plain_least_squares(measurement: Measurement, fitted: Dataset) -> Array:
    """Parameters (n,), SI; what the readings do not see stays near nominal."""
    free = np.flatnonzero(_free(measurement, fitted))
    sigma = measurement.sigma(fitted.series)
    start = measurement.nominal
    scale = measurement.tolerance[free]

    def theta(step: Array) -> Array:
        value = start.copy()
        value[free] += scale * step
        return value

    def residuals(step: Array) -> Array:
        return (measurement.readings(fitted.series, theta(step)) - fitted.y) / sigma

    def slopes(step: Array) -> Array:
        jacobian = measurement.jacobian(fitted.series, theta(step))[:, free]
        return np.asarray(jacobian * scale / sigma[:, None])

    found = least_squares(residuals, np.zeros(len(free)), jac=slopes, method="trf")
    return theta(found.x)


def _free(measurement: Measurement, fitted: Dataset) -> Mask:
    """Parameters that are fitted (n,): of the machine, and of set-ups that were read."""
    size = len(measurement.machine.parameters)
    read = {s.setup for s in fitted.series}
    setups = np.array([n.partition(".")[0] in read for n in measurement.names])
    machine = np.arange(len(measurement.names)) < size
    return np.asarray(measurement.free & (machine | setups))


def held_out_rms(measurement: Measurement, held_out: Dataset, theta: Array) -> Figures:
    """Rms of held-out readings at machine parameters, by set-up and channel."""
    figures: Figures = {}
    start = 0
    for series in held_out.series:
        channels = measurement.setups[series.setup].instrument.channels
        stop = start + len(series) * len(channels)
        residual = _adjusted(measurement, series, held_out.y[start:stop], theta)
        start = stop
        for k, channel in enumerate(channels):
            members = residual[k :: len(channels)]
            rms = float(np.sqrt(np.mean(members**2)))
            unit = units.FINE[channel.unit]
            figures[series.setup, channel.name] = units.number(rms, unit)
    return figures


def _adjusted(
    measurement: Measurement, series: Series, y: Array, theta: Array
) -> Array:
    """Residuals without what the set-up's own unknowns explain."""
    own = np.array([n.startswith(f"{series.setup}.") for n in measurement.names])
    columns = np.flatnonzero(own & measurement.free)
    residual = y - measurement.readings([series], theta)
    if not len(columns):
        return residual
    sigma = measurement.sigma([series])
    slopes = measurement.jacobian([series], theta)[:, columns]
    change = np.linalg.lstsq(slopes / sigma[:, None], residual / sigma, rcond=None)[0]
    return np.asarray(residual - slopes @ change)
