"""Refinement of promising plans with the exact model: time moved between stages.

A refined plan selects the readings of each stage anew, given what the later stages add.
Every trial of a stage draws the same machines, so plans differ by their readings alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.linear_algebra import symmetric_inverse
from oed.planning.knowledge import Prior, make_knowledge
from oed.planning.option import Option
from oed.planning.prediction import PlanStage
from oed.planning.problem import PlanProblem, select_readings
from oed.planning.stage_plan import StagePlan, is_better

#: times that time is moved, at most
MAX_ROUNDS = 8
#: exchange sweeps when the readings of a stage are selected
EXCHANGE_SWEEPS = 3
#: rounding of sums of times
TIME_TOLERANCE = 1e-9
#: an option, and how many of its candidates are read
Step = tuple[Option, int]
#: share of a stage's readings that is given up when time is moved to another stage
REPLACED_SHARE = 0.25


def move_time(problem: PlanProblem, plan: StagePlan) -> StagePlan:
    """Spend the time that remains and move time between stages, while that helps."""
    best = evaluate(problem, steps_of(plan))
    for _ in range(MAX_ROUNDS):
        better = _first_improvement(problem, best)
        if better is None:
            break
        best = better
    return best


def _first_improvement(problem: PlanProblem, plan: StagePlan) -> StagePlan | None:
    """The first better plan: the same steps selected anew, then each move."""
    steps = steps_of(plan)
    for trial in [steps, *propose_moves(steps, problem.budget)]:
        candidate = evaluate(problem, trial, plan)
        if is_better(candidate, plan):
            return candidate
    return None


def evaluate(
    problem: PlanProblem, steps: Sequence[Step], reference: StagePlan | None = None
) -> StagePlan:
    """Plan with these numbers of readings, predicted with the exact model.

    reference  a plan of the same options: its later stages say what information is
               added after each stage
    """
    plan = problem.empty_plan()
    for k, (option, count) in enumerate(steps):
        prior = plan.posterior(problem.start)
        later = _stages_of(reference, steps[k + 1 :])
        information = symmetric_inverse(make_knowledge(prior).mean_square_error)
        information = information + sum(
            (stage.information for stage in later), np.zeros_like(information)
        )
        probability = problem.capture_probability(option, prior)
        chosen = select_readings(
            option,
            count,
            information,
            problem.goal.criterion(problem.setup_columns(option)),
            probability,
            EXCHANGE_SWEEPS,
            _reading_time(problem.budget - plan.seconds, steps[k:], later),
        )
        stage = problem.predict(plan, option, chosen, probability)
        plan = problem.extend(plan, stage)
    return plan


def _stages_of(reference: StagePlan | None, steps: Sequence[Step]) -> list[PlanStage]:
    """The stages of a plan with the steps' options, in their order; else none."""
    stages = {} if reference is None else {s.option.name: s for s in reference.stages}
    names = [option.name for option, _ in steps]
    if not all(name in stages for name in names):
        return []
    return [stages[name] for name in names]


def _reading_time(
    seconds: float, steps: Sequence[Step], later: Sequence[PlanStage]
) -> float:
    """Time (s) for the readings of the first step, out of `seconds` for all steps.

    The others take at least their shortest readings, and usually the time for a reading
    that they take in the `later` stages of a reference plan.
    """
    (option, count), others = steps[0], steps[1:]
    available = seconds - option.mounting_seconds
    usual = []
    for (other, other_count), stage in zip(others, later, strict=False):
        reading_time = stage.seconds - other.mounting_seconds
        share = reading_time * other_count / len(stage.chosen)
        usual.append(other.mounting_seconds + share)
    wanted_seconds = max(available - sum(usual), option.shortest_seconds(count))
    return min(available - least_seconds(others), wanted_seconds)


def verify(problem: PlanProblem, plan: StagePlan) -> StagePlan:
    """The same readings, judged by many other machines than when they were chosen."""
    verified = problem.empty_plan()
    for stage in plan.stages:
        prior = verified.posterior(problem.start)
        probability = problem.capture_probability(stage.option, prior)
        judged = problem.predict(
            verified, stage.option, stage.chosen, probability, verifies=True
        )
        verified = problem.extend(verified, judged)
    return verified


def trim(problem: PlanProblem, plan: StagePlan) -> StagePlan:
    """A plan without the readings that its targets do not need.

    Stages with the longest readings give up theirs first.
    """
    steps = steps_of(plan)
    first = evaluate(problem, steps)
    best = min(first, evaluate(problem, steps, first), key=lambda p: p.value)
    slowest_first = sorted(
        range(len(steps)),
        key=lambda k: -float(steps[k][0].candidate_seconds.mean()),
    )
    for k in slowest_first:
        option, most = steps[k]
        least = option.counts[0]
        while best.value <= 1.0 and least < most:
            middle = (least + most) // 2
            trial = evaluate(problem, replaced(steps, k, middle), best)
            if trial.value <= 1.0:
                best, most = trial, middle
            else:
                least = middle + 1
        steps[k] = (option, most)
    return best


def plan_from_counts(
    problem: PlanProblem, counts: dict[int, float]
) -> StagePlan | None:
    """Refined plan from relaxed numbers of readings; None where time is too short.

    counts  {position of the option: relaxed number of its readings}
    """
    steps = []
    for position, count in counts.items():
        option = problem.options[position]
        rounded = int(np.clip(count, option.counts[0], option.counts[-1]))
        steps.append((option, rounded))
    shortened = _shortened(steps, problem.budget)
    if shortened is None:
        return None
    return move_time(problem, evaluate(problem, _ordered(problem, shortened)))


def _shortened(steps: list[Step], budget: float) -> list[Step] | None:
    """The steps with readings left out until the budget (s) pays for the others."""
    while least_seconds(steps) > budget * (1 + TIME_TOLERANCE):
        spare = [count - option.counts[0] for option, count in steps]
        if max(spare) <= 0:
            return None
        k = int(np.argmax(spare))
        steps = replaced(steps, k, steps[k][1] - 1)
    return steps


def _ordered(problem: PlanProblem, steps: Sequence[Step]) -> list[Step]:
    """The steps in the order in which each loses the fewest readings."""
    remaining = list(steps)
    ordered: list[Step] = []
    prior: Prior = problem.start
    while remaining:
        probability = [_mean_probability(problem, o, prior) for o, _ in remaining]
        best = int(np.argmax(np.round(probability, 3)))
        ordered.append(remaining.pop(best))
        prior = evaluate(problem, ordered).posterior(problem.start)
    return ordered


def _mean_probability(problem: PlanProblem, option: Option, prior: Prior) -> float:
    """Mean probability that a candidate of the option is captured."""
    probability: Array = problem.capture_probability(option, prior)
    return float(probability.mean())


# -- moves -----------------------------------------------------------------------------


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
    fewer = max(option.counts[0], int(count * (1 - REPLACED_SHARE)))
    return replaced(steps, k, min(fewer, count))


def _swapped(steps: list[Step], k: int) -> list[Step]:
    """The steps with k and its successor in the other order."""
    return [*steps[:k], steps[k + 1], steps[k], *steps[k + 2 :]]
