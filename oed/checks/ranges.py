"""Predicted range of every reading under the tolerances and the stated noise.

The range is linear about the nominal machine where the exact closure of a few drawn
machines agrees with the slopes; else many machines are drawn through the closure.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.checks.session import SessionReadings
from oed.measurement import draw_parameters

#: machines that test linearity, and machines drawn where it fails
TRIAL, DRAWS = 24, 400
#: values that are predicted at once, a reading of a machine each
VALUES = 1_000_000
#: share of the linear standard deviation that curvature may have
CURVATURE = 0.05
#: probability that one reading of a correct session lies outside its range
FALSE_ALARM = 1e-4


@dataclasses.dataclass(frozen=True)
class Ranges:
    """Predicted ranges of N values, SI.

    nominal  (N,) readings of the nominal machine
    middle  (N,) mean of the prediction
    sd      (N,) its standard deviation, noise included
    factor  half width of a range in standard deviations
    """

    nominal: Array
    middle: Array
    sd: Array
    factor: float

    @property
    def lower(self) -> Array:
        """Lower ends (N,)."""
        return self.middle - self.factor * self.sd

    @property
    def upper(self) -> Array:
        """Upper ends (N,)."""
        return self.middle + self.factor * self.sd

    def outside(self, y: Array) -> Index:
        """Values, by number, that lie outside."""
        return np.flatnonzero(np.abs(y - self.middle) > self.factor * self.sd)


def predict_ranges(session: SessionReadings, rng: np.random.Generator) -> Ranges:
    """Ranges of a session's readings. Raises AssemblyError at the nominal machine."""
    measurement, series = session.measurement, session.series
    nominal = measurement.nominal
    middle = measurement.readings(series, nominal)
    noise = measurement.sigma(series)
    slopes = measurement.jacobian(series, nominal)
    spread = np.linalg.norm(measurement.in_prior_units(slopes), axis=1)
    factor = float(-special.ndtri(0.5 * FALSE_ALARM / len(middle)))
    machines = draw_parameters(measurement, rng, TRIAL)
    exact = measurement.try_readings(series, machines)
    linear = middle + (machines - nominal) @ slopes.T
    curved = np.sqrt(np.mean((exact - linear) ** 2, axis=0))
    if (curved <= CURVATURE * spread + noise).all():
        return Ranges(middle, middle, np.hypot(spread, noise), factor)
    machines = draw_parameters(measurement, rng, DRAWS)
    few = max(VALUES // len(middle), 1)
    parts = np.split(machines, range(few, DRAWS, few))
    exact = np.vstack([measurement.try_readings(series, part) for part in parts])
    drawn = np.nanstd(exact, axis=0)
    mean, sd = np.nanmean(exact, axis=0), np.hypot(drawn, noise)
    return Ranges(middle, mean, sd, factor)
