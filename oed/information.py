"""From readings' slopes to information: whitening, scaling of the columns, Fisher
information, covariance.

Three scalings of the parameter columns occur and must never be mixed up in a report:

"si"         columns as they come;
"length"     every parameter as a length: angles times the machine's lever (the papers'
             d * dbeta), noise 1;
"tolerance"  every parameter in units of its prior standard deviation, readings in units
             of their noise. In this one a singular value of 1 means: as well known from
             the readings as from the drawing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from oed.arrays import Array
from oed.measurement import Measurement, Series
from oed.noise.covariance import Noise, of

Scaling = Literal["si", "length", "tolerance"]


def column_scale(measurement: Measurement, scaling: Scaling) -> Array:
    """Factor (n,) by which each column of H is multiplied."""
    if scaling == "si":
        return np.ones(len(measurement.parameters))
    if scaling == "length":
        return 1.0 / measurement.lengths
    if scaling == "tolerance":
        return measurement.tolerance
    raise ValueError(f"scaling {scaling!r} is none of {get_args(Scaling)}")


def whiten(rows: Array, noise: Noise | Array) -> Array:
    """Rows (N, ...) whitened by their noise: a Noise, or standard deviations (N,) of
    independent readings.
    """
    return of(noise).whiten(rows)


def scaled(
    measurement: Measurement, series: Sequence[Series], at: Array, scaling: Scaling
) -> Array:
    """H (N, n) of readings at theta `at` (n,) in the stated scaling.

    "length" takes the readings as lengths too; only "tolerance" is whitened by their
    noise.
    """
    rows = measurement.jacobian(series, at) * column_scale(measurement, scaling)
    if scaling == "tolerance":
        return measurement.noise(series).whiten(rows)
    return (
        rows * measurement.reading_lengths(series)[:, None]
        if scaling == "length"
        else rows
    )


def fisher(h: Array) -> Array:
    """Fisher information (n, n) of whitened rows (N, n): M = H^T H."""
    return np.asarray(h.T @ h)


def posterior_covariance(h: Array) -> Array:
    """Covariance (n, n), in units of the tolerances, from H (N, n) in "tolerance"
    scaling: (I + H^T H)^-1.

    Computed from the singular values, so that directions no reading sees keep exactly
    their prior variance 1.
    """
    _, s, vt = np.linalg.svd(h, full_matrices=True)
    gain = np.zeros(h.shape[1])
    gain[: s.size] = s**2
    return np.asarray((vt.T / (1.0 + gain)) @ vt)
