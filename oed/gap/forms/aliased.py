"""Errors of references that these readings can tell from the free parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature

#: why an error of a reference cannot be tested that is a parameter by another name
ALIASED = "free parameters change these readings in the same way"
#: share of its squared norm that parameters leave of a column, up to which it is aliased
LEAST_SHARE = 0.002
#: singular value, against the largest, from which parameters change the readings
RANK = 1e-9


def distinct_from_parameters(
    problem: GapProblem, forms: Sequence[tuple[Signature, float]]
) -> list[tuple[Signature, float]]:
    """Forms, with their weights, without columns that free parameters reproduce.

    Priors of the parameters do not count: a length that is off by ten times its
    tolerance is no error of the reference.
    """
    axes, sizes, _ = np.linalg.svd(problem.slopes, full_matrices=False)
    axes = axes[:, sizes > RANK * sizes.max(initial=0.0)]
    distinct = []
    for form, log_weight in forms:
        columns = problem.in_noise_units(form.columns)
        remaining = columns - axes @ (axes.T @ columns)
        share = np.sum(remaining**2, axis=0) / np.sum(columns**2, axis=0)
        chosen = share > LEAST_SHARE
        if (chosen & ~form.shape).any():
            distinct.append((form.take(chosen), log_weight))
    return distinct
