"""Lower bound of the goal from machines that no reading of a combination captures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index, Mask
from oed.design.stages.goal import Goal
from oed.design.stages.option import Option
from oed.design.stages.stage.travel import is_captured

#: machines drawn
MACHINES = 4000
#: standard errors by which the estimate is lowered
SAFETY = 4.0
#: combinations which are treated at once
CHUNK = 1000
#: smallest value, so that its logarithm exists
TINY = 1e-300


def bound_uncaptured(
    options: Sequence[Option],
    goal: Goal,
    information: Array,
    combinations: Index,
    rng: np.random.Generator,
) -> Array:
    """Goal value (T,) at the least of each combination (T, stages) of options.

    It is estimated from drawn machines and lowered by four standard errors. It is next
    to 0 where every machine is captured.

    information  (n, n) about the machine before
    """
    root = np.linalg.cholesky(np.linalg.inv(information))
    errors = rng.standard_normal((MACHINES, len(information))) @ root.T
    uncaptured = _uncaptured(options, errors, rng)
    squared = [np.sum((errors @ factor.T) ** 2, axis=1) for factor in goal.factors]
    squares = np.stack(squared, axis=1)
    least = np.zeros(len(combinations))
    everything = np.arange(len(combinations))
    for part in np.array_split(everything, max(len(combinations) // CHUNK, 1)):
        excluded = uncaptured[combinations[part]].all(axis=1).astype(float)
        mean = excluded @ squares / MACHINES
        variance = np.maximum(excluded @ squares**2 / MACHINES - mean**2, 0.0)
        standard_error = np.sqrt(variance / MACHINES)
        lowered = np.maximum(mean - SAFETY * standard_error, 0.0)
        least[part] = goal.combine(np.sqrt(lowered))
    return np.maximum(least, TINY)


def _uncaptured(
    options: Sequence[Option], errors: Array, rng: np.random.Generator
) -> Mask:
    """Which machines no candidate of an option captures: (options + 1, machines).

    The last row stands for "no option" and excludes no machine.
    """
    uncaptured = np.zeros((len(options) + 1, len(errors)), dtype=bool)
    uncaptured[-1] = True
    for k, option in enumerate(options):
        if option.travel is None:
            continue
        setup_errors = rng.standard_normal((len(errors), option.setup_columns))
        everything = np.arange(len(option.candidates))
        captured = is_captured(option, everything, errors, setup_errors)
        uncaptured[k] = ~captured.any(axis=1)
    return uncaptured
