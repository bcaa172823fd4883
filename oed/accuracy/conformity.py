"""Probability that a true value lies within its tolerance, from what is known of it.

JCGM 106:2012: where g is the density of a quantity Y after all that is known, and the
tolerance is [T_L, T_U], the probability of conformity is

    p = int_{T_L}^{T_U} g(y) dy.

A parameter is normal. The rms error of a pose component over m poses is that of a field
b + J d, where b is known in advance and d is normal. Of errors that were measured at n
poses with standard uncertainty u and no other knowledge, n (true rms)^2 / u^2 has a
noncentral chi-squared distribution of n degrees of freedom and noncentrality
n (measured rms)^2 / u^2.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from oed.base import Array

#: machines drawn: the standard error of a probability is at most 0.0022
DRAWS = 50_000


def parameter_within(value: float, sd: float, low: float, high: float) -> float:
    """Probability that a normal quantity lies between two limits."""
    return float(special.ndtr((high - value) / sd) - special.ndtr((low - value) / sd))


def rms_within(
    known: Array, slopes: Array, root: Array, largest: float, rng: np.random.Generator
) -> float:
    """Probability that the rms of errors known + slopes d is at most `largest`.

    known   (m,) errors that stay and are known
    slopes  (m, p) errors per parameter
    root    (p, k) with root @ root.T the covariance of d
    """
    spread = slopes @ root
    normal = rng.standard_normal((DRAWS, root.shape[1]))
    squares = np.einsum("dk,kl,dl->d", normal, spread.T @ spread, normal, optimize=True)
    squares += 2.0 * (normal @ (spread.T @ known)) + known @ known
    return float(np.mean(np.sqrt(squares / len(known)) <= largest))


def measured_rms_within(
    rms: float, uncertainty: float, poses: int, largest: float
) -> float:
    """Probability that the true rms error over measured poses is at most `largest`."""
    if uncertainty == 0.0:
        return float(rms <= largest)
    scale = poses / uncertainty**2
    return float(special.chndtr(scale * largest**2, poses, scale * rms**2))
