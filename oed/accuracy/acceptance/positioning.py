"""Accuracy and repeatability of positioning, in the manner of ISO 230-2.

At each target i, n_i approaches in a direction have mean x_i and standard deviation s_i.
With both directions B_i is the difference of the means, and

    M   range of the mean bidirectional deviations
    E   range of the unidirectional means over all targets
    B   largest |B_i|
    R   largest max(2 s_i+ + 2 s_i- + |B_i|, 4 s_i+, 4 s_i-)
    A   largest x_i + 2 s_i less the smallest x_i - 2 s_i, over targets and directions.

The standard asks for five approaches a direction along one axis; the caller states how
many there were.
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index
from oed.result.acceptance import PositioningRecord


def positioning(
    errors: Array, target: Index, direction: Array, unit: str
) -> PositioningRecord | None:
    """Figures of errors (n,) in `unit` at numbered targets, approached in directions (n,).

    direction  +1 or -1; NaN where unknown, which counts as one direction

    None where a target has fewer than two approaches in a direction.
    """
    direction = np.where(np.isfinite(direction), direction, 1.0)
    senses = np.unique(direction)
    shape = (len(np.unique(target)), len(senses))
    means, sds = np.empty(shape), np.empty(shape)
    fewest = len(errors)
    for i, place in enumerate(np.unique(target)):
        for k, sense in enumerate(senses):
            values = errors[(target == place) & (direction == sense)]
            if len(values) < 2:
                return None
            fewest = min(fewest, len(values))
            means[i, k], sds[i, k] = values.mean(), values.std(ddof=1)
    accuracy = (means + 2.0 * sds).max() - (means - 2.0 * sds).min()
    reversal = None
    middle = None
    spread = 4.0 * sds.max(axis=1)
    if len(senses) == 2:
        step = np.abs(means[:, 0] - means[:, 1])
        reversal = float(step.max())
        middle = float(np.ptp(means.mean(axis=1)))
        spread = np.maximum(spread, 2.0 * sds.sum(axis=1) + step)
    return PositioningRecord(
        targets=len(means),
        approaches=fewest,
        accuracy=float(accuracy),
        systematic=float(np.ptp(means)),
        repeatability=float(spread.max()),
        mean=middle,
        reversal=reversal,
        unit=unit,
    )
