"""Bases of random smooth curves and fields: their leading Karhunen-Loeve modes.

A curve of standard deviation 1 and correlation length r has, at a distance d, Matern's
correlation for 3/2,

    (1 + a d) exp(-a d),    a = sqrt(3) / r,

that of curves with a slope everywhere (Rasmussen and Williams 2006, Gaussian Processes
for Machine Learning, eq. 4.17). The modes are orthogonal curves whose sum with
independent N(0, 1) coefficients is such a curve; the first few hold nearly all of it.
"""

import functools

import numpy as np

from oed.base.arrays import Array

N_POINTS = 200  #: places in the span at which a curve's modes are computed
#: share of a field's energy below which what is left is rounding
ENERGY_ROUNDING = 1e-12


def curve_mode(
    positions: Array,
    number: int,
    *,
    correlation_length: float,
    count: int,
    detrend: int = 0,
) -> Array:
    """One of the `count` largest modes of a smooth curve from -1 to 1, and at its ends'
    values beyond; detrend: 1 for curves without their mean, 2 without their slope
    either.
    """
    grid, modes = _curve_modes(correlation_length, count, detrend)
    return np.asarray(np.interp(positions, grid, modes[number]))


@functools.cache
def _curve_modes(
    correlation_length: float, count: int, detrend: int
) -> tuple[Array, Array]:
    """Places (N_POINTS,) in the span, and the modes (count, N_POINTS), largest first."""
    grid: Array = (np.arange(N_POINTS, dtype=float) + 0.5) * (2.0 / N_POINTS) - 1.0
    distance = np.abs(grid[:, None] - grid)
    trend = np.linalg.qr(np.vander(grid, detrend))[0]
    projection = np.eye(N_POINTS) - trend @ trend.T
    correlation = _matern(distance, correlation_length)
    values, vectors = np.linalg.eigh(projection @ correlation @ projection)
    modes = np.sqrt(values[-count:]) * vectors[:, -count:]
    return np.asarray(grid), modes.T[::-1]


def field_modes(
    positions: Array, *, correlation_length: float, energy_share: float, count: int
) -> Array:
    """Modes (m, k) of a smooth field at places (m, n), whose products are its kernel.

    As many as hold `energy_share` of the field's energy at these places, `count` at
    most: a Cholesky decomposition with pivots, linear in the number of places
    (Harbrecht, Peters and Schneider 2012, Appl. Numer. Math. 62, 428-440).
    """
    distinct, inverse = np.unique(np.round(positions, 9), axis=0, return_inverse=True)
    unexplained, modes = np.ones(len(distinct)), np.zeros((len(distinct), 0))
    spare = max(1.0 - energy_share, ENERGY_ROUNDING)
    while modes.shape[1] < count and unexplained.mean() > spare:
        pivot = int(np.argmax(unexplained))
        distance = np.linalg.norm(distinct - distinct[pivot], axis=1)
        remainder = _matern(distance, correlation_length) - modes @ modes[pivot]
        mode = remainder / np.sqrt(unexplained[pivot])
        modes = np.column_stack([modes, mode])
        unexplained = np.maximum(unexplained - mode**2, 0.0)
    return modes[inverse.ravel()]


def _matern(distance: Array, correlation_length: float) -> Array:
    """Matern's correlation of order 3/2 at distances, of the same shape."""
    scaled = np.sqrt(3.0) / correlation_length * distance
    return np.asarray((1.0 + scaled) * np.exp(-scaled))
