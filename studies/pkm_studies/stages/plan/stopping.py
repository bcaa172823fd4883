"""Where to stop: what one more stage would gain, and why the plan does not have it."""

from __future__ import annotations

from oed.design.stages.search import PlanSearchResult
from oed.design.stages.sequence.stage_plan import StagePlan
from pkm_studies.stages.plan.phrases import percent
from pkm_studies.stages.plan.task import ANY_LOSS, PlanTask

#: relative gain below which a further measurement does not help
NO_GAIN = 5e-4


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
