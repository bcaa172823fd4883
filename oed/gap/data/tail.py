"""Log tail probabilities of the chi-square distribution, however small."""

from __future__ import annotations

import numpy as np
from scipy import special

from oed.base.arrays import Array


def log_tail(energy: Array, rank: Array | float) -> Array:
    """Log of the chi-square's upper tail; 0 for rank 0.

    Its asymptote stands in where the tail underflows.
    """
    a = np.maximum(rank, 1e-9) / 2.0
    x = np.maximum(energy, 0.0) / 2.0
    tail = special.gammaincc(a, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        correction = np.log1p((a - 1.0) / x)
        asymptote = -x + (a - 1.0) * np.log(x) - special.gammaln(a) + correction
        value = np.where(tail > 1e-280, np.log(tail), asymptote)
    return np.where(np.asarray(rank) == 0, 0.0, value)
