"""Thins a dense trace to means of blocks, with the noise that these means have.

Neighbouring points of a trace share noise, so that a mean of m points has a variance of
sigma^2 / m (1 + 2 sum_j (1 - j/m) rho_j), not sigma^2 / m. It is estimated from the means
themselves: what a Fourier series over the angle leaves of them.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import units
from oed.base.arrays import Array

#: harmonics of a turn that are not noise, at most
HARMONICS = 15


@dataclasses.dataclass(frozen=True)
class Thinned:
    """A trace of block means.

    angle    (n,) rad
    reading  (n,) m
    time     (n,) s, NaN where unknown
    block    points a mean
    sigma    standard deviation of a mean, m
    lag_one  correlation of neighbouring means
    """

    angle: Array
    reading: Array
    time: Array
    block: int
    sigma: float
    lag_one: float


def thin(angle: Array, reading: Array, time: Array, most: int) -> Thinned:
    """A trace (n,) as at most `most` means of blocks of equal length.

    Points beyond the last whole block, fewer than a block, are left out.
    """
    block = max(1, -(-len(angle) // most))
    count = len(angle) // block

    def means(values: Array) -> Array:
        return np.asarray(values[: count * block].reshape(count, block).mean(axis=1))

    around, level = means(angle), means(reading)
    residual, free = _residual(around, level)
    sigma = float(np.sqrt(np.sum(residual**2) / max(free, 1)))
    lag_one = 0.0
    if free > 1 and sigma > 0.0:
        lag_one = float(residual[1:] @ residual[:-1] / np.sum(residual**2))
    return Thinned(around, level, means(time), block, sigma, lag_one)


def _residual(angle: Array, reading: Array) -> tuple[Array, int]:
    """What a Fourier series over the angle leaves, and its degrees of freedom."""
    turns = abs(angle[-1] - angle[0]) / (360.0 * units.DEG)
    harmonics = min(HARMONICS, int(len(angle) * min(turns, 1.0)) // 6)
    columns = [np.ones_like(angle)]
    for k in range(1, harmonics + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    basis = np.column_stack(columns)
    fitted, _, rank, _ = np.linalg.lstsq(basis, reading)
    return reading - basis @ fitted, len(angle) - int(rank)
