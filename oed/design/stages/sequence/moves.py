"""Steps of a plan (option, number of readings), and moves of time between them."""

from __future__ import annotations

from collections.abc import Sequence

from oed.design.stages.option import Option
from oed.design.stages.sequence.stage_plan import StagePlan

#: an option, and how many of its candidates are read
Step = tuple[Option, int]

#: share of a stage's readings that is given up when time is moved to another stage
SHARE = 0.25


def steps_of(plan: StagePlan) -> list[Step]:
    """The steps of a plan."""
    return [(stage.option, len(stage.chosen)) for stage in plan.stages]


def least_seconds(steps: Sequence[Step]) -> float:
    """Shortest time (s) of stages with these numbers of readings."""
    return sum(o.mounting_seconds + o.shortest_seconds(n) for o, n in steps)


def propose_moves(steps: list[Step], budget: float) -> list[list[Step]]:
    """Changes to try, each within the budget (s).

    First all stages filled up with the time that remains; then fewer readings in one
    stage, and more in others for the time that this frees; last, neighbours swapped.
    """
    count = range(len(steps))
    trials = [fill(steps, budget, last) for last in count]
    for giver in count:
        lowered = _lowered(steps, giver)
        if lowered != steps:
            receivers = [k for k in count if k != giver]
            trials += [fill(lowered, budget, giver, first) for first in receivers]
    trials += [_swapped(steps, k) for k in count[:-1]]
    return [
        trial
        for k, trial in enumerate(trials)
        if trial != steps and trial not in trials[:k]
    ]


def fill(steps: list[Step], budget: float, last: int, first: int = 0) -> list[Step]:
    """As many readings as the budget pays for: in step `first`, then others, `last`."""
    order = sorted(range(len(steps)), key=lambda k: (k == last, k != first))
    filled = list(steps)
    for k in order:
        option, count = filled[k]
        others = least_seconds(filled[:k] + filled[k + 1 :])
        affordable = option.affordable_counts(budget - others)
        if affordable and affordable[-1] > count:
            filled[k] = (option, affordable[-1])
    return filled


def replaced(steps: Sequence[Step], k: int, count: int) -> list[Step]:
    """The steps with another number of readings in step k."""
    changed = list(steps)
    changed[k] = (steps[k][0], count)
    return changed


def _lowered(steps: list[Step], k: int) -> list[Step]:
    """The steps with fewer readings in step k; unchanged where it has the fewest."""
    option, count = steps[k]
    fewer = max(option.counts[0], int(count * (1 - SHARE)))
    return replaced(steps, k, min(fewer, count))


def _swapped(steps: list[Step], k: int) -> list[Step]:
    """The steps with k and its successor in the other order."""
    return [*steps[:k], steps[k + 1], steps[k], *steps[k + 2 :]]
