"""The plan stage: which measurement at which stage, within a time budget."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import msgspec
import numpy as np

from oed.base import units
from oed.design.stages.search import PlanSearchResult
from pkm_studies.base.progress import Progress
from pkm_studies.resolve.plan import PlanRequest
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.plan.alternatives import list_alternatives
from pkm_studies.stages.plan.comparison import compare_sequence
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.section import PlanOutcome, build_outcome
from pkm_studies.stages.plan.stopping import describe_stop, without_small_stages
from pkm_studies.stages.plan.targets import describe_needs
from pkm_studies.stages.plan.task import PlanTask, build_task
from pkm_studies.stages.plan.virtual import add_realisations


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
