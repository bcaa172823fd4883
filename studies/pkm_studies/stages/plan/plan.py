"""The plan stage: which measurement at which stage, within a time budget."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import msgspec
import numpy as np

from oed import result
from oed.base import units
from oed.base.arrays import Array
from oed.design.stages.search import PlanSearchResult
from oed.design.stages.sequence.stage_plan import StagePlan
from oed.design.stages.virtual_machines.propagation import StageRealisation, propagate
from pkm_studies.base import Progress
from pkm_studies.resolve.plan import PlanRequest
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.plan.alternatives import list_alternatives
from pkm_studies.stages.plan.comparison import compare_sequence
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.effects import compare_without_effects
from pkm_studies.stages.plan.phrases import percent
from pkm_studies.stages.plan.section import PlanOutcome, build_outcome
from pkm_studies.stages.plan.targets import describe_needs
from pkm_studies.stages.plan.task import ANY_LOSS, PlanTask, build_task

#: relative gain below which a further measurement does not help
NO_GAIN = 5e-4


def compute_plan(
    resolved: ResolvedStudy,
    request: PlanRequest,
    seed: Sequence[int],
    machines: np.random.Generator,
    progress: Progress,
    earlier: EarlierSession | None,
) -> PlanOutcome:
    """The plan that the study requests.

    seed      of the study and the plan stage
    machines  draws virtual machines
    earlier   session before; `resolved` is then about the machine as identified there

    Raises InputError where the time pays for no measurement.
    """
    task = build_task(resolved, request, seed, earlier)
    search = _search(task, progress)
    best = without_small_stages(task, search)
    outcome = build_outcome(task, search, best)
    start = None if earlier is None else earlier.covariance
    stages = add_realisations(
        task, best, outcome.section.stages, machines, progress, start
    )
    sequences = task.request.compare
    section = msgspec.structs.replace(
        outcome.section,
        stages=stages,
        virtual_machines=task.table.virtual_machines,
        alternatives=[*list_alternatives(task, search, best)],
        needs=describe_needs(task, search),
        stop=describe_stop(task, search, best),
        compared=[compare_sequence(task, names, search) for names in sequences],
        after="" if earlier is None else earlier.words,
        effects=compare_without_effects(task, best, outcome, earlier, progress),
    )
    return dataclasses.replace(outcome, section=section)


def _search(task: PlanTask, progress: Progress) -> PlanSearchResult:
    """The best plan; where there is none, InputError with what can help."""
    try:
        return task.search(progress=progress.share)
    except ValueError as error:
        remedy = "plan no further"
        if task.request.options:
            remedy = "give more time, or list fewer measurements or stages"
        if task.request.reserved:
            reserved = units.number(task.request.reserved, "min")
            remedy += f" ({reserved:g} min of it are for [gap.design])"
        raise task.place.key("budget_min").error(
            str(error), remedy, task.table.budget_min
        ) from error


# -- virtual machines through the plan -------------------------------------------------


def add_realisations(
    task: PlanTask,
    plan: StagePlan,
    records: list[result.StageRecord],
    rng: np.random.Generator,
    progress: Progress,
    start: Array | None,
) -> list[result.StageRecord]:
    """The records of a plan's stages, with the accuracy that virtual machines reach.

    start  (n, n) covariance from which machines are drawn, in units of the tolerances;
           None: the tolerances
    """
    if not task.table.virtual_machines:
        return records
    progress.stage("virtual machines through the plan")
    where = task.request.prediction
    realisation = propagate(
        plan.stages,
        where.command,
        task.table.virtual_machines,
        rng,
        reference=where.table.reference,
        start=start,
        progress=progress.share,
    )
    return [
        _with_realisation(record, stage, realisation.names)
        for record, stage in zip(records, realisation.stages, strict=True)
    ]


def _with_realisation(
    record: result.StageRecord, stage: StageRealisation, names: tuple[str, ...]
) -> result.StageRecord:
    ratios = zip(names, stage.ratio, strict=True)
    return msgspec.structs.replace(
        record,
        realised={name: float(v) for name, v in ratios if np.isfinite(v)},
        realised_lost=stage.realised_loss * (record.chosen or 0),
        coverage=stage.coverage,
    )


# -- where to stop ---------------------------------------------------------------------


def without_small_stages(task: PlanTask, search: PlanSearchResult) -> StagePlan:
    """The best plan, without last stages that gain less than the study's `worth`.

    A plan of fewer stages that is nearly as accurate takes its place.
    """
    best = search.best
    if not task.table.worth or task.goal.has_targets:
        return best
    while len(best.stages) > 1:
        shorter = task.search(stages=len(best.stages) - 1, loss=ANY_LOSS).best
        gain = 1.0 - best.value / shorter.value
        if gain >= task.table.worth:
            break
        best = shorter
    return best


def describe_stop(task: PlanTask, search: PlanSearchResult, best: StagePlan) -> str:
    """Where the plan stops, and what the next stage would gain."""
    if best is not search.best:
        return _small_stages(task, search.best, best)
    if search.next_gain is None:
        return "after the last stage; every measurement of the list is in the plan."
    name, gain = search.next_gain
    if gain < NO_GAIN:
        return (
            "after the last stage; no further measurement of the list helps (the next"
            f" best is {name})."
        )
    text = (
        f"after the last stage; one more, {name}, would make errors"
        f" {percent(gain)} smaller"
    )
    worth = task.table.worth
    if gain < worth:
        return f"{text}, less than the {percent(worth)} that the study asks for."
    least = task.request.option(name).least_seconds
    has_time = task.budget - best.seconds >= least
    if has_time and len(best.stages) >= task.table.stages:
        return f"{text}, but the study allows {task.table.stages} stages."
    return f"{text}, but no time remains for it."


def _small_stages(task: PlanTask, longer: StagePlan, best: StagePlan) -> str:
    gain = percent(1.0 - longer.value / best.value)
    names = ", then ".join(longer.names)
    return (
        f"after these {len(best.stages)}; {len(longer.stages)} stages ({names}) would"
        f" make errors {gain} smaller, less than the {percent(task.table.worth)} that"
        " the study asks for."
    )
