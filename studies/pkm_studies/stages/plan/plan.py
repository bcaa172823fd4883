"""The plan stage: which measurement at which stage, within a time budget."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed import result, units
from oed.base import Array, Index
from oed.effects import PlannedEffects
from oed.planning import (
    Option,
    PlanSearchResult,
    StagePlan,
    StageRealisation,
    propagate,
)
from pkm_studies.base import Progress
from pkm_studies.resolve import PlanRequest, ResolvedStudy, named_effects
from pkm_studies.stages.plan.comparison import compare_sequence, predict_readings
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.phrases import (
    accuracies,
    more_accurate,
    percent,
    time_difference,
)
from pkm_studies.stages.plan.section import PlanOutcome, build_outcome
from pkm_studies.stages.plan.targets import describe_needs, missed_accuracy
from pkm_studies.stages.plan.task import ANY_LOSS, PlanTask, build_task
from pkm_studies.stages.recording import PlanToRecord, recording_section

# The plan for a machine without effects, on a machine that has them.


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
    location = task.location.key("effects")
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
            effects=named_effects(gap, task.table.effects, location),
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


# Other sequences of measurements, each with the reason why it is not the plan.

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
    best = drop_small_stages(task, search)
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
        raise task.location.key("budget_min").error(
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
        _add_realisation(record, stage, realisation.names)
        for record, stage in zip(records, realisation.stages, strict=True)
    ]


def _add_realisation(
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


def drop_small_stages(task: PlanTask, search: PlanSearchResult) -> StagePlan:
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
