"""Search for the best sequence of stages within a time budget.

1. A beam search grows plans stage by stage, with a first look at each. A rough
   stage comes first where it lets the next instrument follow, and not elsewhere.
2. The best sequences are refined with the exact model (`refine`), and verified.
3. A bound over all plans (`bound`) certifies the best one, and names combinations of
   measurements which could still be better: these are refined as well.

All plans on the way form the Pareto front of accuracy against time.

After each partial plan in the beam, every option is tried as the next stage, with
several numbers of readings. The most accurate plans go on, and the most accurate for
their time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed import units
from oed.base import Array
from oed.linear_algebra import symmetric_inverse
from oed.planning import refine
from oed.planning.bound import GoalBound, bound_goal
from oed.planning.goal import Goal
from oed.planning.option import Option
from oed.planning.problem import PlanProblem
from oed.planning.stage_plan import StageMemory, StagePlan, best_plan, pareto_front
from oed.planning.streams import PlanStreams

#: number of partial plans in the beam, where none is asked for
BEAM_SIZE = 6

Evaluated = dict[tuple[tuple[str, int], ...], StagePlan]


def beam_search(
    problem: PlanProblem, beam: int, progress: Callable[[float], None] | None
) -> list[StagePlan]:
    """All partial plans that were evaluated, in the order of their evaluation.

    progress  is called with the share of the work that is done
    """
    evaluated: Evaluated = {}
    parents = [problem.empty_plan()]
    for depth in range(problem.stages):
        grown: dict[tuple[str, ...], StagePlan] = {}
        for k, parent in enumerate(parents):
            for child in _children(problem, parent):
                evaluated[_step_names(child)] = child
                key = (*sorted(child.names), str(len(child.stages)))
                if key not in grown or _rank(child) < _rank(grown[key]):
                    grown[key] = child
            if progress is not None:
                level = depth + (k + 1) / len(parents)
                progress(level / problem.stages)
        if not grown:
            break
        parents = _next_beam(list(grown.values()), beam)
    return list(evaluated.values())


def _step_names(plan: StagePlan) -> tuple[tuple[str, int], ...]:
    """Option and number of readings of each stage."""
    return tuple((s.option.name, len(s.chosen)) for s in plan.stages)


def _next_beam(plans: list[StagePlan], beam: int) -> list[StagePlan]:
    """The most accurate plans, then the most accurate for their time."""
    by_value = sorted(plans, key=lambda plan: plan.value)[: beam // 2 + 1]
    by_rank = sorted(plans, key=_rank)[:beam]
    distinct = list(dict.fromkeys([*by_value, *by_rank]))
    return distinct[: beam + 2]


def _rank(plan: StagePlan) -> float:
    """Log of the value, corrected for time; value ~ 1 / sqrt(time) is usual."""
    return float(np.log(plan.value) + 0.5 * np.log(max(plan.seconds, 1.0)))


def _children(problem: PlanProblem, parent: StagePlan) -> list[StagePlan]:
    """A plan with one more stage: each further option, with each number to try."""
    seconds = problem.budget - parent.seconds
    prior = parent.posterior(problem.start)
    children = []
    for option in problem.options:
        if option.name in parent.names:
            continue
        probability = problem.capture_probability(option, prior)
        reading_time = seconds - option.mounting_seconds
        for count in option.affordable_counts(seconds):
            child = problem.first_look(parent, option, count, probability, reading_time)
            children.append(child)
    return children


#: sequences which are refined
REFINED_SEQUENCES = 6
#: value at a first look up to which a refined plan can reach its targets
NEAR_TARGET_VALUE = 1.1
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
    beam: int | None = None,
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
    partial = beam_search(
        problem, beam or BEAM_SIZE, _scaled(progress, 0.0, BEAM_SHARE)
    )
    if not partial:
        raise ValueError(_too_short(problem))
    refined = _refine(problem, partial, _scaled(progress, BEAM_SHARE, 1.0))
    value = min(plan.value for plan in refined)
    bound = bound_goal(
        options,
        goal,
        symmetric_inverse(start),
        budget,
        stages,
        value,
        streams.bound,
        loss=loss,
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
    for k, plan in enumerate(_by_combination(by_value)[:REFINED_SEQUENCES]):
        refined.append(refine.move_time(problem, plan))
        if progress is not None:
            progress((k + 1) / REFINED_SEQUENCES)
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
    near = [plan for plan in by_time if plan.value <= NEAR_TARGET_VALUE]
    shortest = _by_combination(near)
    on_target = [plan for plan in refined if plan.value <= 1.0]
    trimmed = [
        refine.trim(problem, plan)
        for plan in [*shortest[:REFINED_SEQUENCES], *on_target]
    ]
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
