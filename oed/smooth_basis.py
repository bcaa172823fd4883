"""Random smooth curves over a span, and fields over several coordinates, told by a few
modes.

A curve of standard deviation 1 whose values hang together over a reach r has, at a
distance d, Matern's correlation

    (1 + a d) exp(-a d),    a = sqrt(3) / r,

that of curves with a slope everywhere (Rasmussen and Williams 2006, Gaussian Processes
for Machine Learning, eq. 4.17). Its Karhunen-Loeve modes are the orthogonal curves
whose sum with independent N(0, 1) coefficients is such a curve; the first few hold
nearly all of it.
"""

from __future__ import annotations

import functools

import numpy as np

from oed.arrays import Array

POINTS = 200


def curve_mode(
    at: Array, number: int, *, correlation_length: float, count: int, detrend: int = 0
) -> Array:
    """Mode `number` of the `count` largest at places (...) in a span from -1 to 1; held
    at its end beyond.

    reach     r, where the span is 2 long;  straight: 1 for curves without their mean, 2
              without their slope either
    """
    grid, made = _modes(correlation_length, count, detrend)
    return np.asarray(np.interp(at, grid, made[number]))


@functools.cache
def _modes(reach: float, count: int, straight: int) -> tuple[Array, Array]:
    """Places (k,) in the span, and the modes there (count, k), the largest first."""
    grid: Array = (np.arange(POINTS, dtype=float) + 0.5) * (2.0 / POINTS) - 1.0
    way = np.sqrt(3.0) / reach * np.abs(grid[:, None] - grid)
    lines = np.linalg.qr(np.vander(grid, straight))[0]
    left = np.eye(POINTS) - lines @ lines.T
    values, vectors = np.linalg.eigh(left @ ((1.0 + way) * np.exp(-way)) @ left)
    return np.asarray(grid), np.asarray(
        (np.sqrt(values[-count:]) * vectors[:, -count:]).T[::-1]
    )


def field_modes(
    places: Array, *, correlation_length: float, energy_share: float, count: int
) -> Array:
    """Modes (m, k) of a field of standard deviation 1 with the same correlation of
    places (m, n), the largest first.

    share   of the field's energy in these places that the modes hold, of at most
            `count` modes
    """
    there, back = np.unique(np.round(places, 9), axis=0, return_inverse=True)
    way = (
        np.sqrt(3.0)
        / correlation_length
        * np.linalg.norm(there[:, None] - there, axis=-1)
    )
    values, vectors = np.linalg.eigh((1.0 + way) * np.exp(-way))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    enough = int(np.searchsorted(np.cumsum(values), energy_share * values.sum())) + 1
    kept = min(enough, count)
    return np.asarray((vectors[:, :kept] * np.sqrt(values[:kept]))[back.ravel()])
