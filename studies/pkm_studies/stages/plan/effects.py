"""The plan for a machine without effects, on a machine that has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from oed import result
from oed.base import units
from oed.base.arrays import Index
from oed.compensate.effects.planned_effects import PlannedEffects
from oed.design.stages.option import Option
from oed.design.stages.sequence.stage_plan import StagePlan
from pkm_studies.base import Progress
from pkm_studies.resolve.planned_effects import named_effects
from pkm_studies.stages.plan.comparison import predict_readings
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.phrases import accuracies
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.stages.plan.task import PlanTask, build_task
from pkm_studies.stages.recording import PlanToRecord, recording_section


def compare_without_effects(
    task: PlanTask,
    best: StagePlan,
    outcome: PlanOutcome,
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
        recording=_recording(task, effects, best, outcome),
    )


def _recording(
    task: PlanTask, effects: PlannedEffects, best: StagePlan, outcome: PlanOutcome
) -> result.RecordingSection | None:
    """What else to record beside the readings of the plan."""
    resolved, request = task.resolved, task.request
    measurement = outcome.measurement
    free = int(measurement.free[: len(measurement.machine.parameters)].sum())
    gap = resolved.gap_or_default
    place = task.place.key("effects")
    setups = set(measurement.setups)
    further = {}
    for option in request.options:
        if option.name not in best.names:
            mounted = resolved.measurement_with({*setups, *option.measurement.setups})
            further[option.name] = (mounted, option.series_of(_spread(option)))
    return recording_section(
        PlanToRecord(
            measurement=measurement,
            series=outcome.series,
            planned=effects,
            effects=named_effects(gap, task.table.effects, place),
            request=gap,
            prediction=request.prediction,
            information=np.asarray(
                np.linalg.inv(task.start[:free, :free]), dtype=float
            ),
            seconds=units.factor("min") * (task.table.budget_min or 0.0),
            seed=task.seed,
            further=further,
        )
    )


def _spread(option: Option) -> Index:
    """As many candidates as a measurement has at least, spread over all."""
    last = len(option.candidates) - 1
    return np.unique(np.linspace(0, last, option.counts[0]).round().astype(np.intp))


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
