"""Virtual machines: true parameters drawn from the tolerances, and their readings.

A virtual machine obeys the exact closure at its true parameters, which the
identification does not know; its controller uses the nominal ones. Tests of the model
itself use machines that are written independently of this code.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.measurement import Measurement, Series


def draw_parameters(
    measurement: Measurement, rng: np.random.Generator, machines: int | None = None
) -> Array:
    """Draw true parameters theta (n,) or (machines, n), SI, about nominal."""
    n = len(measurement.parameters)
    shape = (n,) if machines is None else (machines, n)
    deviation = measurement.tolerance * rng.standard_normal(shape)
    return np.asarray(measurement.nominal + deviation)


def draw_readings(
    measurement: Measurement,
    series: Sequence[Series],
    truth: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw noisy readings y (N,) or (m, N), SI, of machines at `truth` (n,) or (m, n).

    Raises AssemblyError where a pose cannot be assembled.
    """
    exact = measurement.readings(series, truth)
    return exact + measurement.noise(series).draw(rng, exact.shape)
