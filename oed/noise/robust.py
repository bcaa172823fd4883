"""Readings in place of those far off, so that a fit with normal noise is not bent.

A residual that its neighbours and the prior contradict is replaced by one of normal
noise with the same information (pseudo-values, `oed.noise.outliers`). What is replaced
is judged against the widest residual that the tolerances allow, so that no error of the
machine is taken for an outlier.
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array, Index
from oed.noise import outliers
from oed.noise.process import Laws
from oed.noise.process_noise import dense_covariance
from oed.noise.structure import ReadingStructure

#: readings judged together; the covariance of more would not fit into memory
MOST_TOGETHER = 2000
#: fewest readings among which one can be told to be far off
FEWEST = 8


def robust_residuals(
    structure: ReadingStructure, laws: Laws, residual: Array, slopes: Array
) -> Array:
    """Residuals (N,) about the prior's middle, with those far off replaced.

    slopes  (N, r) over z ~ N(0, I), which hold what the machine may do
    """
    clean = residual.copy()
    for members in _together(structure):
        part = structure.take(members)
        h = slopes[members]
        covariance = dense_covariance(part, laws) + h @ h.T
        result = outliers.detect(
            residual[members],
            covariance,
            outliers.ROBUST_DENSITIES,
            structure.statement,
        )
        if result is not None:
            clean[members] = result.pseudo_residual
    return clean


def _together(structure: ReadingStructure) -> list[Index]:
    """Readings that are judged together: all, or whole chains, or parts of long ones."""
    order = np.lexsort((structure.position, structure.chain))
    parts = -(-len(order) // MOST_TOGETHER)
    groups = np.array_split(order, parts)
    return [np.sort(group) for group in groups if len(group) >= FEWEST]
