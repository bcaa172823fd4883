"""Correlated noise in plain NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def autoregression(white: NDArray[np.float64], decay: float) -> NDArray[np.float64]:
    """Stationary errors (n,) of unit variance, from independent normal numbers (n,)."""
    error = white.copy()
    fresh = np.sqrt(1.0 - decay**2)
    for k in range(1, len(white)):
        error[k] = decay * error[k - 1] + fresh * white[k]
    return error
