"""Other sequences of measurements, each with the reason why it is not the plan."""

from __future__ import annotations

import numpy as np

from oed import result
from oed.design.stages.option import Option
from oed.design.stages.search import PlanSearchResult
from oed.design.stages.sequence.stage_plan import StagePlan
from pkm_studies.stages.plan.phrases import more_accurate, percent, time_difference
from pkm_studies.stages.plan.targets import missed_accuracy
from pkm_studies.stages.plan.task import ANY_LOSS, PlanTask

#: largest number of measurements that are left out of the plan in turn
LEFT_OUT = 4
#: share of lost readings from which a reason mentions it
LOST = 0.05
#: relative difference of accuracy that counts as none
SAME = 5e-4
#: beam of the searches
NARROW = 2


def list_alternatives(
    task: PlanTask, search: PlanSearchResult, best: StagePlan
) -> list[result.AlternativePlan]:
    """Plans without each measurement in turn, then others that the search refined."""
    names = {best.names}
    records = []
    for option in [stage.option for stage in best.stages][:LEFT_OUT]:
        plan = search_without(task, best, option)
        if plan is not None and plan.names not in names:
            names.add(plan.names)
            reason = f"without {option.name}: {why_not(task, plan, best)}"
            records.append(task.record(plan, reason))
    for plan in search.alternatives:
        if plan.names not in names:
            names.add(plan.names)
            records.append(task.record(plan, why_not(task, plan, best)))
    return records


def search_without(task: PlanTask, best: StagePlan, option: Option) -> StagePlan | None:
    """Best plan of the other measurements in the same time, if there is one."""
    others = [s.option for s in best.stages if s.option is not option]
    if not others:
        return None
    try:
        search = task.search(
            best.seconds,
            options=others,
            stages=len(others),
            beam=NARROW,
            loss=ANY_LOSS,
        )
    except ValueError:  # mounting alone takes longer
        return None
    return search.most_accurate


def why_not(task: PlanTask, plan: StagePlan, best: StagePlan) -> str:
    """What speaks against a plan: lost readings, missed targets, accuracy, time."""
    reasons = _lost_readings(plan, best)
    if task.goal.has_targets and plan.value > 1.0:
        covariance = task.posterior_covariance(plan)
        worst = int(np.argmax(task.goal.accuracy(covariance)))
        missed = missed_accuracy(task, covariance, task.goal.names[worst])
        return "; ".join([*reasons, f"reaches {missed}"])
    accuracy = _accuracy_difference(plan, best)
    time = time_difference(plan.seconds, best.seconds)
    return "; ".join([*reasons, f"{accuracy} {time}"])


def _lost_readings(plan: StagePlan, best: StagePlan) -> list[str]:
    """Whether a plan loses readings because it lacks a rough stage."""
    losses = [(stage.lost_share, stage.option.name) for stage in plan.stages]
    share, name = max(losses, default=(0.0, ""))
    usual = max((stage.lost_share for stage in best.stages), default=0.0)
    if share <= LOST or share <= 2.0 * usual:
        return []
    return [
        f"a rough stage is missing: {percent(share)} of the readings of {name} would"
        " be lost"
    ]


def _accuracy_difference(plan: StagePlan, best: StagePlan) -> str:
    worse = plan.value / best.value - 1.0
    if worse > 1.0:
        return f"{worse + 1.0:.3g} times less accurate"
    if worse > SAME:
        return f"{percent(worse)} less accurate"
    if worse < -SAME:
        return more_accurate(best.value, plan.value)
    return "as accurate"
