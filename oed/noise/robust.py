"""Readings in place of those far off, so that a fit with normal noise is not bent.

A residual that its neighbours and the prior contradict is replaced by one of normal
noise with the same information (pseudo-values, `oed.noise.outliers`). What is replaced
is judged against the widest residual that the tolerances allow, so that no error of the
machine is taken for an outlier.
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.noise import outliers
from oed.noise.law_noise import factor_of
from oed.noise.process import Laws
from oed.noise.structure import ReadingStructure

#: fewest readings among which one can be recognised as far off
FEWEST = 8


def robust_residuals(
    structure: ReadingStructure, laws: Laws, residual: Array, slopes: Array
) -> Array:
    """Residuals (N,) about the prior's middle, with those far off replaced.

    slopes  (N, r) over z ~ N(0, I), which hold what the machine may do
    """
    if len(residual) < FEWEST:
        return residual.copy()
    if structure.has_effects:
        slopes = np.hstack([slopes, structure.effects])
    precision = outliers.with_columns(factor_of(structure, laws), slopes)
    result = outliers.detect(
        residual, precision, outliers.ROBUST_DENSITIES, structure.statement
    )
    return residual.copy() if result is None else result.pseudo_residual
