"""Tail probabilities of the chi-square, however small."""

from __future__ import annotations

import numpy as np
from scipy import special

from oed.arrays import Array


def log_tail(energy: Array, rank: Array | float) -> Array:
    """Log of the chi-square's upper tail; its asymptote where that underflows; 0 for
    rank 0.
    """
    a, x = np.maximum(rank, 1e-9) / 2.0, np.maximum(energy, 0.0) / 2.0
    tail = special.gammaincc(a, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = -x + (a - 1.0) * np.log(x) - special.gammaln(a) + np.log1p((a - 1.0) / x)
        return np.where(
            np.asarray(rank) == 0, 0.0, np.where(tail > 1e-280, np.log(tail), far)
        )
