"""Lower bound of the goal over all plans within the budget: a certificate for a plan.

Each combination T of options has an upper bound of log phi, phi = 1 / value^2. One
supporting line bounds all combinations at once (`combination_bound`). The combination
with the highest bound is then solved as a relaxation, which gives a new line, tight
there. This goes on until no combination can be better than the loss allows.

A machine out of the travel of every reading of every option in T stays as it is,
whatever is mounted first. Their share bounds the goal from below (`bound_uncaptured`).
Other losses of readings, and the linearisation residual, only make plans worse and are
left out.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.design.stages.bound.combination_bound import CombinationBound
from oed.design.stages.goal import Goal
from oed.design.stages.option import Option
from oed.design.stages.stage.travel import is_captured
from oed.linear_algebra import precision_root

#: largest number of combinations that are bounded
COMBINATIONS = 200_000
#: combinations that are reported as promising
PROMISING = 4
#: gain of a line in log phi below which a relaxation has reached its own tolerance
STUCK = 1e-9
#: machines drawn
MACHINES = 4000
#: standard errors by which the estimate is lowered
SAFETY = 4.0
#: combinations which are treated at once
CHUNK = 1000
#: smallest value, so that its logarithm exists
TINY = 1e-300


@dataclasses.dataclass(frozen=True)
class GoalBound:
    """No plan within the budget has a smaller goal value than `value`.

    lines      supporting lines that were computed
    promising  combinations that can hold a better plan, most promising first, as
               {position of the option: relaxed number of readings}
    """

    value: float
    lines: int
    promising: tuple[dict[int, float], ...] = ()


def bound_goal(
    options: Sequence[Option],
    goal: Goal,
    information: Array,
    budget: float,
    stages: int,
    value: float,
    rng: np.random.Generator,
    *,
    loss: float = 0.05,
    lines: int = 150,
) -> GoalBound:
    """Bound the goal over all plans of at most `stages` options within `budget` (s).

    Lines are added until a plan with `value` is certified to be within the share `loss`
    of the best plan, or until there are `lines` of them.

    information  (n, n) about the machine before
    rng          draws the machines that no reading captures

    Raises ValueError where there are too many combinations.
    """
    mounting = np.array([option.mounting_seconds for option in options])
    combinations = _combinations(mounting, budget, stages)
    if not len(combinations):
        return GoalBound(np.inf, 0)
    least = bound_uncaptured(options, goal, information, combinations, rng)
    upper = -2.0 * np.log(least)
    goal_bound = CombinationBound.of(options, goal, information, budget)
    rest = goal.least_rest
    target = _log_phi(_reducible(value / (1.0 + loss), rest))
    relaxed: dict[int, dict[int, float]] = {}
    computed = 0
    while computed < lines:
        best = int(np.argmax(upper))
        if upper[best] <= target:
            break
        members = [position for position in combinations[best] if position >= 0]
        weights = goal_bound.relax(members)
        relaxed[best] = {int(s): float(w.sum()) for s, w in weights.items()}
        line = goal_bound.bound_all(combinations, weights)
        is_stuck = line[best] >= upper[best] - STUCK
        upper = np.minimum(upper, line)
        computed += 1
        if is_stuck:
            break
    highest = float(upper.max())
    least_better = _log_phi(_reducible(value, rest))
    better = [k for k in relaxed if upper[k] > least_better]
    ranked = sorted(better, key=lambda k: -upper[k])
    promising = tuple(relaxed[k] for k in ranked[:PROMISING])
    total = math.sqrt(math.exp(-highest) + rest)
    return GoalBound(total, computed, promising)


def _reducible(value: float, rest: float) -> float:
    """The part of a goal value that readings reduce."""
    return math.sqrt(max(value**2 - rest, TINY))


def _log_phi(value: float) -> float:
    return -2.0 * math.log(value)


def _combinations(mounting: Array, budget: float, stages: int) -> Index:
    """Combinations (T, stages) of options that the budget mounts, padded with -1."""
    count = len(mounting)
    stages = min(stages, count)
    total = sum(math.comb(count, size) for size in range(1, stages + 1))
    if total > COMBINATIONS:
        raise ValueError(
            f"{total} combinations of {stages} of {count} measurements are too many to"
            " bound"
        )
    tables = []
    for size in range(1, stages + 1):
        rows = list(itertools.combinations(range(count), size))
        table = np.array(rows, dtype=np.intp)
        table = table[mounting[table].sum(axis=1) < budget]
        padding = ((0, 0), (0, stages - size))
        tables.append(np.pad(table, padding, constant_values=-1))
    return np.concatenate(tables)


# -- machines that no reading captures -------------------------------------------------


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
    root = precision_root(information)
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
        if not option.limits_travel:
            continue
        setup_errors = rng.standard_normal((len(errors), option.setup_columns))
        everything = np.arange(len(option.candidates))
        captured = is_captured(option, everything, errors, setup_errors)
        uncaptured[k] = ~captured.any(axis=1)
    return uncaptured
