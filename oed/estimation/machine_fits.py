"""Fits of many machines at once, with known noise.

They are fitted over u, theta = nominal + T u, T the root of the prior covariance. The
minimum is that of `oed.estimation.identification`: where the gradient is zero, u has no
part in the directions that no reading determines.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.estimation.coordinates import ReadingsProblem
from oed.estimation.fitter import PRECISION, minimise
from oed.estimation.identification import identify
from oed.measurement.measurement import Measurement, Series

#: distance to the minimum, in posterior standard deviations, at which a stage before the
#: last ends: it finds a start
NEAR = 0.1
#: entries of the slopes of all machines that are held in memory at once
ENTRIES = 4_000_000


def fit_machines(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
) -> Array:
    """Parameters theta (m, n), SI, of m machines with readings y (m, N), SI.

    stages  patterns of parameter names, freed in turn, as in `identify`

    Raises IdentificationError where a machine cannot be fitted.
    """
    size = max(1, ENTRIES // (y.shape[1] * len(measurement.parameters)))
    parts = [
        _fit_together(measurement, series, y[start : start + size], stages)
        for start in range(0, len(y), size)
    ]
    return np.vstack(parts)


def _fit_together(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    stages: Sequence[Sequence[str]],
) -> Array:
    noise = measurement.noise(series)
    theta = np.repeat(measurement.nominal[None], len(y), axis=0)
    converged = np.ones(len(y), dtype=bool)
    for k, patterns in enumerate(stages, 1):
        freed = measurement.freed(patterns)
        basis = measurement.prior_root(freed)[:, freed]
        origin = np.where(freed, measurement.nominal, theta)
        offset = (theta - origin)[:, freed]
        start = np.asarray(np.linalg.solve(basis[freed], offset.T).T, dtype=float)
        problem = ReadingsProblem(measurement, series, noise, y, origin, basis)
        precision = PRECISION if k == len(stages) else NEAR
        minima = minimise(problem, start, precision=precision)
        theta = origin + minima.z @ basis.T
        converged &= minima.converged
    # a fit of its own says what is wrong
    for row in np.flatnonzero(~converged):
        theta[row] = identify(measurement, series, y[row], stages=stages).theta
    return theta
