"""Outliers of the residuals while columns in the model hold any gap."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.noise import outliers
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers


def detect_outliers(
    problem: GapProblem, law: NoiseLaw, columns: Array
) -> Outliers | None:
    """Outliers under a law, with columns (N, k) of prior N(0, 1) in the model."""
    held = np.hstack([problem.slopes, columns])
    precision = outliers.with_columns(law.factor(problem), held)
    return outliers.detect(problem.residual, precision, statement=problem.statement)


def without_outliers(problem: GapProblem, removed: Outliers | None) -> GapProblem:
    """The problem with pseudo-residuals in place of the outliers, if there are any."""
    if removed is None:
        return problem
    return problem.with_residual(removed.pseudo_residual)
