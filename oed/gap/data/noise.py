"""Noise law and outliers of the residuals, beside columns that may hold a gap."""

from __future__ import annotations

import numpy as np

from oed.arrays import Array
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.noise import estimate, outliers
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers


def fit_law(
    problem: GapProblem,
    columns: Array,
    start: NoiseLaw | None = None,
    size: float | Array = 1.0,
) -> tuple[NoiseLaw, float]:
    """The law that explains the residual best beside columns (N, k) of prior N(0,
    size^2), and the log of the prior mass about it.
    """
    wide = evidence.compressed(problem, columns * size)

    def log_evidence(law: NoiseLaw) -> float:
        return evidence.log_evidence(problem, law, wide)

    return estimate.fit(problem, log_evidence, start)


def detect_outliers(
    problem: GapProblem, law: NoiseLaw, columns: Array
) -> Outliers | None:
    """Outliers under a law, beside columns (N, k) of prior N(0, 1)."""
    covariance = columns @ columns.T + problem.slopes @ problem.slopes.T
    for number, members in enumerate(problem.blocks):
        covariance[np.ix_(members, members)] += law.block(problem, number)
    return outliers.detect(problem.residual, covariance)


def without_outliers(problem: GapProblem, found: Outliers | None) -> GapProblem:
    """The residuals with their outliers pulled in, if there are any."""
    return problem if found is None else problem.with_residual(found.residual)
