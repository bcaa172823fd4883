"""Beam search over sequences of stages, with a first look at each.

After each partial plan in the beam, every option is tried as the next stage, with
several numbers of readings. The most accurate plans go on, and the most accurate for
their time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oed.design.stages.sequence.problem import PlanProblem
from oed.design.stages.sequence.stage_plan import StagePlan

#: partial plans in the beam
BEAM = 6

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
