"""Search for the best sequence of stages within a time budget.

1. A beam search grows plans stage by stage, with a first look at each (`beam`). A rough
   stage comes first where it lets the next instrument follow, and not elsewhere.
2. The best sequences are refined with the exact model (`refine`), and verified.
3. A bound over all plans (`bound`) certifies the best one, and names combinations of
   measurements which could still be better: these are refined as well.

All plans on the way form the Pareto front of accuracy against time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed import units
from oed.base import Array
from oed.design.forms.protocol import inverse
from oed.design.stages.bound.goal_bound import GoalBound, bound_goal
from oed.design.stages.goal import Goal
from oed.design.stages.option import Option
from oed.design.stages.sequence import refine
from oed.design.stages.sequence.beam import BEAM, beam_search
from oed.design.stages.sequence.problem import PlanProblem
from oed.design.stages.sequence.stage_memory import StageMemory
from oed.design.stages.sequence.stage_plan import StagePlan, best_plan, pareto_front
from oed.design.stages.streams import PlanStreams

#: sequences which are refined
REFINED = 6
#: value at a first look up to which a refined plan can reach its targets
NEAR_TARGET = 1.1
#: share of the progress that the beam search takes
BEAM_SHARE = 0.8

Progress = Callable[[float], None]


@dataclasses.dataclass(frozen=True, eq=False)
class PlanSearchResult:
    """Result of a search.

    best           the plan: the most accurate one within the budget, or, with targets,
                   the shortest one that reaches them
    reached        whether the targets are reached; True without targets
    front          Pareto front of accuracy against time, shortest first
    alternatives   other refined sequences, best first
    bound          lower bound of the goal over all plans within the budget
    most_accurate  the plan of the smallest value
    next_gain      option of the best further stage, and its relative gain, if there
                   were time for it; None: all options are in the plan
    """

    best: StagePlan
    reached: bool
    front: tuple[StagePlan, ...]
    alternatives: tuple[StagePlan, ...]
    bound: GoalBound
    most_accurate: StagePlan
    next_gain: tuple[str, float] | None

    @property
    def loss(self) -> float:
        """Share by which `most_accurate` can be worse than the best possible plan."""
        return max(self.most_accurate.value / self.bound.value - 1.0, 0.0)


def search_plan(
    options: Sequence[Option],
    goal: Goal,
    budget: float,
    streams: PlanStreams,
    *,
    covariance: Array | None = None,
    stages: int = 4,
    beam: int = BEAM,
    loss: float = 0.05,
    progress: Progress | None = None,
    memory: StageMemory | None = None,
) -> PlanSearchResult:
    """Search for the best sequence of at most `stages` stages within `budget` seconds.

    covariance  (n, n) of the machine before, in units of the tolerances; by default
                the tolerances themselves
    loss        share of the value within which the best plan is to be certified
    memory      stages that searches with the same covariance and streams predicted

    Raises ValueError where the budget pays for no option.
    """
    start = np.eye(goal.parameters) if covariance is None else covariance
    problem = PlanProblem(
        tuple(options), goal, budget, stages, start, streams, memory or StageMemory()
    )
    partial = beam_search(problem, beam, _scaled(progress, 0.0, BEAM_SHARE))
    if not partial:
        raise ValueError(_too_short(problem))
    refined = _refine(problem, partial, _scaled(progress, BEAM_SHARE, 1.0))
    value = min(plan.value for plan in refined)
    bound = bound_goal(
        options, goal, inverse(start), budget, stages, value, streams.bound, loss=loss
    )
    for counts in bound.promising:
        plan = refine.plan_from_counts(problem, counts)
        if plan is not None:
            refined.append(refine.verify(problem, plan))
    most_accurate = best_plan(refined)
    best, enough = most_accurate, list[StagePlan]()
    if goal.has_targets:
        enough = _plans_on_target(problem, partial, refined)
        best = min(enough, key=lambda plan: plan.seconds, default=most_accurate)
    front = pareto_front([problem.empty_plan(), *partial, *refined])
    if goal.has_targets:
        front = pareto_front([*front, *enough])
    others = [plan for plan in refined if plan is not best]
    return PlanSearchResult(
        best=best,
        reached=bool(enough) or not goal.has_targets,
        front=tuple(front),
        alternatives=tuple(sorted(others, key=lambda plan: plan.value)),
        bound=bound,
        most_accurate=most_accurate,
        next_gain=_next_gain(problem, best),
    )


def _scaled(progress: Progress | None, first: float, last: float) -> Progress | None:
    """Progress of a part of the search that runs from share `first` to `last`."""
    if progress is None:
        return None
    return lambda share: progress(first + (last - first) * share)


def _too_short(problem: PlanProblem) -> str:
    if not problem.options:
        return "no measurement is left to plan"
    least = min(option.least_seconds for option in problem.options)
    budget = units.number(problem.budget, "min")
    return (
        f"the budget of {budget:.1f} min pays for no measurement: the shortest takes"
        f" {units.number(least, 'min'):.1f} min"
    )


def _by_combination(plans: Sequence[StagePlan]) -> list[StagePlan]:
    """The first plan of each combination of options."""
    combinations: dict[tuple[str, ...], StagePlan] = {}
    for plan in plans:
        combinations.setdefault(tuple(sorted(plan.names)), plan)
    return list(combinations.values())


def _refine(
    problem: PlanProblem, partial: Sequence[StagePlan], progress: Progress | None
) -> list[StagePlan]:
    """The best combinations of options, refined and verified."""
    by_value = sorted(partial, key=lambda plan: plan.value)
    refined = []
    for k, plan in enumerate(_by_combination(by_value)[:REFINED]):
        refined.append(refine.move_time(problem, plan))
        if progress is not None:
            progress((k + 1) / REFINED)
    return [refine.verify(problem, plan) for plan in refined]


def _plans_on_target(
    problem: PlanProblem,
    partial: Sequence[StagePlan],
    refined: Sequence[StagePlan],
) -> list[StagePlan]:
    """Plans that reach the targets, among them trimmed ones.

    Trimmed are the refined plans, and of every combination of options the shortest plan
    that seems to reach the targets.
    """
    by_time = sorted(partial, key=lambda plan: plan.seconds)
    near = [plan for plan in by_time if plan.value <= NEAR_TARGET]
    shortest = _by_combination(near)
    on_target = [plan for plan in refined if plan.value <= 1.0]
    trimmed = [refine.trim(problem, plan) for plan in [*shortest[:REFINED], *on_target]]
    verified = [refine.verify(problem, plan) for plan in trimmed]
    return [plan for plan in [*refined, *verified] if plan.value <= 1.0]


def _next_gain(problem: PlanProblem, best: StagePlan) -> tuple[str, float] | None:
    """The option whose further stage would gain most, and its relative gain."""
    prior = best.posterior(problem.start)
    gains = []
    for option in problem.options:
        if option.name in best.names:
            continue
        probability = problem.capture_probability(option, prior)
        grown = problem.first_look(best, option, option.counts[-1], probability)
        gains.append((option.name, 1.0 - grown.value / best.value))
    return max(gains, key=lambda gain: gain[1], default=None)
