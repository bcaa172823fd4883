"""Virtual machines: readings of a machine whose true parameters are known.

The virtual machine obeys the exact closure at parameters the identification does not
know; its controller believes in the nominal ones. (Tests of the model itself use
machines written independently of this code.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.measurement import Measurement, Series


def draw_parameters(
    measurement: Measurement, rng: np.random.Generator, machines: int | None = None
) -> Array:
    """True parameters theta (n,) or (machines, n), drawn from the tolerances about
    nominal.
    """
    shape = (
        (len(measurement.parameters),)
        if machines is None
        else (machines, len(measurement.parameters))
    )
    return measurement.nominal + measurement.tolerance * rng.standard_normal(shape)


def draw_readings(
    measurement: Measurement,
    series: Sequence[Series],
    truth: Array,
    rng: np.random.Generator,
) -> Array:
    """Noisy readings y (N,) or (m, N) of machines with parameters `truth` (n,) or (m,
    n), SI.
    """
    exact = measurement.readings(series, truth)
    return exact + measurement.noise(series).draw(rng, exact.shape)
