"""Targets out of reach: how far the best plan misses them, what would reach them."""

from __future__ import annotations

import dataclasses

from oed.base import Array
from oed.planning import Option, PlanSearchResult, StagePlan, covariance_of_all
from pkm_studies.stages.plan.phrases import minutes
from pkm_studies.stages.plan.task import ANY_LOSS, PlanTask

#: beam of the searches
NARROW = 2


def describe_needs(task: PlanTask, search: PlanSearchResult) -> list[str]:
    """What would have to change to reach the targets; empty where they are reached."""
    if search.reached or not task.goal.has_targets:
        return []
    sentences = [_proof(task, search), _limit(task)]
    double = 2.0 * task.budget
    try:
        longer = task.search(double, beam=NARROW, loss=ANY_LOSS).most_accurate
        sentences.append(_effect(longer, f"twice the time ({minutes(double)})"))
    except ValueError:  # even twice the time pays for no measurement
        pass
    finer = [_half_noise(option) for option in task.request.options]
    precise = task.search(options=finer, beam=NARROW, loss=ANY_LOSS).most_accurate
    sentences.append(_effect(precise, "half the noise"))
    return sentences


def missed_accuracy(task: PlanTask, covariance: Array, component: str) -> str:
    """The accuracy that a component reaches, with its unit."""
    parts = []
    for key, value in task.accuracy(covariance).items():
        name, _, unit = key.rpartition("_")
        if name == component:
            parts.append(f"{component} only to {value:.3g} {unit}")
    return ", ".join(parts)


def _proof(task: PlanTask, search: PlanSearchResult) -> str:
    """How far the best plan misses the targets, and whether a better one can exist."""
    text = (
        f"Out of reach in {minutes(task.budget)}: the best plan misses the target of"
        f" the worst component by a factor of {search.most_accurate.value:.3g}"
    )
    bound = search.bound.value
    if bound > 1.0:
        return f"{text}, and no plan of these measurements gets below {bound:.3g} (proven)."
    return f"{text}; a plan that reaches it is not excluded (bound {bound:.3g})."


def _limit(task: PlanTask) -> str:
    """What all candidate readings together leave: the limit of these measurements."""
    covariance = covariance_of_all(task.request.options, task.start)
    value = task.goal.value(covariance)
    if value <= 1.0:
        return (
            "All readings of all measurements together would reach it if none were lost"
            f" ({value:.3g} of the target)."
        )
    return (
        "Even all readings of all measurements together miss it by a factor of"
        f" {value:.3g}: it takes a set-up or an instrument that sees what these do not"
        f" ({_all_missed(task, covariance)})."
    )


def _effect(plan: StagePlan, change: str) -> str:
    """Whether a change is enough."""
    names = ", ".join(plan.names)
    if plan.value <= 1.0:
        return f"{change.capitalize()} is enough ({names})."
    return (
        f"{change.capitalize()} is not enough: a factor of {plan.value:.3g} is missing"
        f" ({names})."
    )


def _half_noise(option: Option) -> Option:
    """The option with half the noise."""
    candidates = option.candidates
    finer = dataclasses.replace(candidates, blocks=2.0 * candidates.blocks)
    return dataclasses.replace(option, candidates=finer)


def _all_missed(task: PlanTask, covariance: Array) -> str:
    """The components that miss their target."""
    shares = zip(task.goal.names, task.goal.accuracy(covariance), strict=True)
    missed = [name for name, share in shares if share > 1.0]
    return ", ".join(missed_accuracy(task, covariance, name) for name in missed)
