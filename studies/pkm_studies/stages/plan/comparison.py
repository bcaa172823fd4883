"""Sequences of measurements from the study, compared with the best plan of their time.

A sequence takes all readings of each measurement. Where they take longer than the
budget, it takes the best readings within it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed import result
from oed.base import Index
from oed.design import CRITERIA
from oed.identifiability import assess
from oed.planning import Option, PlanSearchResult, PlanStreams, StagePlan, predict_plan
from pkm_studies.base import InputError
from pkm_studies.stages.plan.phrases import loss_bound_text, minutes, more_accurate
from pkm_studies.stages.plan.task import ANY_LOSS, PlanTask

#: share by which times and values may differ and count as the same
SAME = 1e-6


def compare_sequence(
    task: PlanTask, names: Sequence[str], search: PlanSearchResult
) -> result.SequenceRecord:
    """A sequence's rank, indices, time and accuracy, and the best plan of its time.

    Raises InputError where the time pays for none of its measurements.
    """
    sequence = predict_sequence(task, names)
    seconds = sequence.seconds
    if seconds > task.budget * (1.0 + SAME):
        sequence, seconds = _keep_within_budget(task, names, search), task.budget
    best, bound = _best_plan(task, sequence, search, seconds)
    readings = [s for stage in sequence.stages for s in stage.series]
    measurement = task.resolved.measurement_with({s.setup for s in readings})
    explained = assess(measurement, readings)
    singular_values = explained.identifiability.identifiable_singular_values
    return result.SequenceRecord(
        name=", then ".join(names),
        sequence=task.record(sequence),
        rank=explained.identifiability.rank,
        parameters=len(explained.names),
        kappa=CRITERIA.index("kappa", singular_values),
        weakest=float(singular_values[-1]),
        observability=CRITERIA.observability(
            singular_values, sum(len(s) for s in readings)
        ),
        lost=_lost_share(sequence),
        plan=task.record(best),
        gain=_gain(task, sequence, best),
        bound=bound,
        words=_sentence(task, sequence, best, bound, seconds),
    )


def predict_sequence(task: PlanTask, names: Sequence[str]) -> StagePlan:
    """All candidates of each measurement, one measurement after the other."""
    options = [task.request.option(name) for name in names]
    return predict_readings(
        task, [(option, np.arange(len(option.candidates))) for option in options]
    )


def predict_readings(
    task: PlanTask, readings: Sequence[tuple[Option, Index]]
) -> StagePlan:
    """Some candidates of each measurement, one measurement after the other."""
    streams = PlanStreams.seeded(task.seed)
    return predict_plan(readings, task.goal, task.start, streams, task.stage_generator)


def _keep_within_budget(
    task: PlanTask, names: Sequence[str], search: PlanSearchResult
) -> StagePlan:
    """The best plan of these measurements alone within the budget."""
    options = [task.request.option(name) for name in names]
    try:
        own_search = task.search(options=options, stages=len(options), loss=ANY_LOSS)
    except ValueError as error:
        raise task.location.key("compare").error(
            str(error), "give more time, or compare others", list(names)
        ) from error
    plans = [own_search.most_accurate]
    for plan in [search.best, search.most_accurate, *search.alternatives]:
        if set(plan.names) <= set(names):
            plans.append(plan)
    return min(plans, key=lambda plan: plan.value)


def _best_plan(
    task: PlanTask, sequence: StagePlan, search: PlanSearchResult, seconds: float
) -> tuple[StagePlan, float]:
    """The most accurate plan in a time, the sequence among them, and the bound."""
    if abs(seconds - task.budget) > SAME * task.budget:
        try:
            search = task.search(seconds * (1.0 + SAME))
        except ValueError as error:
            raise InputError(
                str(error), "compare a sequence that takes longer", field="plan.compare"
            ) from error
    best = min(search.most_accurate, sequence, key=lambda plan: plan.value)
    return best, search.bound.value


def _lost_share(plan: StagePlan) -> float:
    """Expected share of all chosen candidates that are lost."""
    chosen = sum(len(stage.chosen) for stage in plan.stages)
    lost = sum((1.0 - stage.probability).sum() for stage in plan.stages)
    return float(lost) / chosen


def _gain(task: PlanTask, sequence: StagePlan, best: StagePlan) -> dict[str, float]:
    """Factor by which the best plan is more accurate, for each component."""
    after = task.accuracy_after(best)
    return {
        name: value / after[name]
        for name, value in task.accuracy_after(sequence).items()
        if after.get(name, 0.0) > 0.0
    }


def _sentence(
    task: PlanTask,
    sequence: StagePlan,
    best: StagePlan,
    bound: float,
    seconds: float,
) -> str:
    time = minutes(seconds)
    if best is sequence or sequence.value < best.value * (1.0 + SAME):
        loss = max(sequence.value / bound - 1.0, 0.0)
        return (
            f"The search finds no better plan of {time}; none is more than"
            f" {loss_bound_text(loss)}."
        )
    gain = more_accurate(sequence.value, best.value)
    text = f"In {time}, {', then '.join(best.names)} is {gain}"
    if task.goal.has_targets and best.value > 1.0 and bound > 1.0:
        return (
            f"{text}; the target is out of reach in that time (proven: it is missed by"
            f" a factor of at least {bound:.3g})."
        )
    loss = max(best.value / bound - 1.0, 0.0)
    return f"{text}; no plan of that time is more than {loss_bound_text(loss)}."
