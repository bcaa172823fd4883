"""Whitened and scaled Jacobian of readings, their Fisher information and covariance.

There are three scalings of the parameter columns; a report must never mix them:

"si"         SI units
"length"     every parameter as a length: angles times the machine's lever (the papers'
             d * dbeta), noise 1
"tolerance"  every parameter in units of its prior standard deviation, readings in units
             of their noise; a singular value of 1 means that the readings determine a
             direction as well as the drawing does
"""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from oed.base import Array
from oed.measurement import Measurement, Series

Scaling = Literal["si", "length", "tolerance"]


def column_scale(measurement: Measurement, scaling: Scaling) -> Array:
    """Factor (n,) by which each column of H is multiplied."""
    if scaling == "si":
        return np.ones(len(measurement.parameters))
    if scaling == "length":
        return 1.0 / measurement.length_factors
    if scaling == "tolerance":
        return measurement.tolerance
    raise ValueError(f"scaling {scaling!r} is none of {get_args(Scaling)}")


def scaled(
    measurement: Measurement, series: Sequence[Series], theta: Array, scaling: Scaling
) -> Array:
    """H (N, n) of readings at theta (n,) in the stated scaling.

    "length" turns the readings into lengths too. Only "tolerance" whitens them.
    """
    jacobian = measurement.jacobian(series, theta)
    return scaled_jacobian(measurement, series, jacobian, scaling)


def scaled_jacobian(
    measurement: Measurement,
    series: Sequence[Series],
    jacobian: Array,
    scaling: Scaling,
) -> Array:
    """`scaled`, from the Jacobian (N, n) of the readings, SI."""
    rows = jacobian * column_scale(measurement, scaling)
    if scaling == "tolerance":
        return measurement.noise(series).whiten(rows)
    if scaling == "length":
        return rows * measurement.reading_length_factors(series)[:, None]
    return rows


def prior_information(measurement: Measurement) -> Array:
    """Information (k, k) of the prior on the k free parameters, in tolerance units."""
    free = np.flatnonzero(measurement.free)
    correlation = measurement.correlation
    if correlation is None:
        return np.eye(len(free))
    block = correlation[np.ix_(free, free)]
    return np.asarray(np.linalg.inv(block), dtype=float)


def parameter_covariance(
    measurement: Measurement, series: Sequence[Series], theta: Array
) -> Array:
    """Posterior covariance (n, n), SI, of theta from readings at theta (n,)."""
    white = measurement.noise(series).whiten(measurement.jacobian(series, theta))
    scaled = posterior_covariance(measurement.in_prior_units(white))
    return measurement.from_prior_units(scaled)


def posterior_covariance(h: Array) -> Array:
    """Covariance (I + H^T H)^-1 (n, n), in units of the tolerances.

    H (N, n) is in "tolerance" scaling. The singular values give directions that no
    reading determines exactly their prior variance 1.
    """
    readings, n = h.shape
    # all n right vectors are needed, but never a square of the many readings
    _, singular_values, vt = np.linalg.svd(h, full_matrices=readings < n)
    gain = np.zeros(n)
    gain[: singular_values.size] = singular_values**2
    return np.asarray((vt.T / (1.0 + gain)) @ vt)
