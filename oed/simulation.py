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
from oed.noise.process import Whitening, stated_laws
from oed.noise.structure import common_statement, reading_structure


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
    return exact + draw_errors(measurement, series, rng, exact.shape)


def draw_errors(
    measurement: Measurement,
    series: Sequence[Series],
    rng: np.random.Generator,
    shape: tuple[int, ...],
) -> Array:
    """Errors (..., N), SI, of the stated noise with the tails that are stated."""
    tails = common_statement(measurement, series)
    if tails.student_dof is None and not tails.outlier_share:
        return measurement.noise(series).draw(rng, shape)
    structure = reading_structure(measurement, series, measurement.nominal)
    laws = stated_laws(structure, int(np.prod(shape[:-1])))
    errors = Whitening(structure, laws).draw(rng, tails)
    return structure.restore(errors).reshape(shape)
