"""The plan for a machine without effects, on a machine that has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from oed import result
from oed.design.stages.sequence.stage_plan import StagePlan
from oed.design.stages.stage import travel
from oed.design.stages.stage.knowledge import Prior
from oed.design.stages.stage.prediction import PlanStage, predict_stage
from pkm_studies.base.progress import Progress
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.phrases import accuracies
from pkm_studies.stages.plan.streams import plan_streams
from pkm_studies.stages.plan.task import PlanTask, build_task


def compare_without_effects(
    task: PlanTask,
    earlier: EarlierSession | None,
    progress: Progress,
) -> result.PlanEffects | None:
    """The effects of a plan, beside the plan without them; None where it has none."""
    effects = task.request.effects
    if effects is None:
        return None
    progress.stage("plan for a machine without effects")
    options = tuple(option.without_effects() for option in task.request.options)
    request = dataclasses.replace(task.request, options=options, effects=None)
    rigid = build_task(task.resolved, request, task.seed, earlier)
    promised = rigid.search(progress=progress.share).best
    reached = _on_machine_with_effects(task, promised)
    without = task.record(reached)
    promises = rigid.accuracy_after(promised)
    return result.PlanEffects(
        groups=len(effects.groups),
        unknowns=effects.readings.count,
        without=without,
        promised=promises,
        words=_words(len(effects.groups), without, promises),
    )


def _on_machine_with_effects(task: PlanTask, plan: StagePlan) -> StagePlan:
    """The same readings in the same order, with effects."""
    prior: Prior = task.start
    stages: list[PlanStage] = []
    for k, stage in enumerate(plan.stages):
        option = task.request.option(stage.option.name)
        capture = plan_streams(task.seed).capture()
        probability = travel.capture_probability(option, prior, capture)
        rng = task.stage_generator(k)
        stages.append(predict_stage(option, stage.chosen, prior, probability, rng))
        prior = stages[-1].posterior
    covariances = [task.start, *(stage.covariance for stage in stages)]
    return StagePlan(
        stages=tuple(stages),
        seconds=plan.seconds,
        value=task.goal.value(covariances[-1]),
        accuracy=tuple(task.goal.accuracy(c) for c in covariances),
    )


def _words(
    groups: int, without: result.AlternativePlan, promised: Mapping[str, float]
) -> str:
    """What the plan without effects promises, and what it reaches."""
    names = ", then ".join(without.names)
    return (
        f"The plan allows for {groups} groups of effects beside the geometry, at the sizes"
        f" expected of them. The plan for a machine without effects ({names}) promises"
        f" {accuracies(promised)} rms; on a machine with them it leaves"
        f" {accuracies(without.accuracy)}."
    )
