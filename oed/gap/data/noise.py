"""Outliers of the residuals while columns in the model hold any gap."""

from __future__ import annotations

import numpy as np

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers, detect


def detect_outliers(
    problem: GapProblem, law: NoiseLaw, columns: Array
) -> Outliers | None:
    """Outliers under a law, with columns (N, k) of prior N(0, 1) in the model."""
    covariance = columns @ columns.T + problem.slopes @ problem.slopes.T
    for number, members in enumerate(problem.members):
        covariance[np.ix_(members, members)] += law.block(problem, number)
    return detect(problem.residual, covariance, statement=problem.statement)


def without_outliers(problem: GapProblem, outliers: Outliers | None) -> GapProblem:
    """The problem with pseudo-residuals in place of the outliers, if there are any."""
    return (
        problem if outliers is None else problem.with_residual(outliers.pseudo_residual)
    )
