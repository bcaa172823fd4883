"""The plan for a machine without effects, on a machine that has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from oed import result
from pkm_studies.base.progress import Progress
from pkm_studies.stages.plan.comparison import predict_readings
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.phrases import accuracies
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
    same_readings = [
        (task.request.option(stage.option.name), stage.chosen)
        for stage in promised.stages
    ]
    without = task.record(predict_readings(task, same_readings))
    promises = rigid.accuracy_after(promised)
    return result.PlanEffects(
        groups=len(effects.groups),
        unknowns=effects.readings.count,
        without=without,
        promised=promises,
        words=_words(len(effects.groups), without, promises),
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
