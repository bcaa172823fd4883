"""Inverse root of a Gram matrix over the directions that the readings show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oed.base.arrays import Array
from oed.base.linear_algebra import eigenvectors


def inverse_root(gram: Array, least: Callable[[float], float]) -> Array:
    """R (k, m) with R R^T the pseudo-inverse of a Gram matrix (k, k).

    Directions of less energy than `least`, a function of the largest energy, are left
    out.
    """
    values, vectors = eigenvectors(gram)
    visible = values > least(float(values.max(initial=0.0)))
    return np.asarray(vectors[:, visible] / np.sqrt(values[visible]))
