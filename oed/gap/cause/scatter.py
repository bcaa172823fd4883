"""Whether readings scatter beyond what their instrument is stated to.

A data sheet states the scatter of single readings, and is right to a factor. What exceeds
it is noise that the data sheet excludes, or an effect of a form that no answer has.
"""

from __future__ import annotations

import numpy as np

from oed.checks.judgement import KNOWN_TO
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw
from oed.result.trust import chi2_is_large


def excess_scatter(problem: GapProblem, law: NoiseLaw) -> float | None:
    """Scatter of readings within their runs over the stated one; None where it is as stated.

    It holds single errors and those carried along a run, not what a run repeats to, of
    which data sheets say nothing. None where the stated noise is an assumption.
    """
    if problem.statement.is_assumed:
        return None
    variance = law.variance + law.ar1_sd**2
    if law.channel_ratio is not None:
        variance = variance * law.channel_ratio**2
    factor = law.level * float(np.sqrt(np.mean(variance)))
    freedom = float(len(problem.residual) - problem.slopes.shape[1])
    chi2 = freedom * (factor / KNOWN_TO) ** 2
    return factor if freedom > 0.0 and chi2_is_large(chi2, freedom) else None
