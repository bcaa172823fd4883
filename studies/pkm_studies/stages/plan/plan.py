"""The plan stage: which measurement at which stage, within a time budget."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from oed import result, units
from oed.base import Array, Index
from oed.design import CRITERIA
from oed.effects import PlannedEffects
from oed.identifiability import Assessment, combination_text
from oed.measurement import Measurement, Series
from oed.planning import Option, PlanSearchResult, PlanStage, StagePlan
from pkm_studies.base import InputError, Progress, Stream
from pkm_studies.resolve import PlanRequest
from pkm_studies.stages.design import order
from pkm_studies.stages.plan.task import ANY_LOSS, EarlierSession, PlanTask, build_task
from pkm_studies.stages.recording import PlanToRecord, recording_section
from pkm_studies.tables import DesignTable

if TYPE_CHECKING:
    from pkm_studies.stages.run_state import RunState

# Targets out of reach: how far the best plan misses them, what would reach them.

NARROW_SHARE = 2  #: beam of the searches


def describe_needs(task: PlanTask, search: PlanSearchResult) -> list[str]:
    """What would have to change to reach the targets; empty where they are reached."""
    if search.reached or not task.goal.has_targets:
        return []
    sentences = [_proof(task, search), _limit(task)]
    double = 2.0 * task.budget
    try:
        longer = task.search(double, beam=NARROW_SHARE, loss=ANY_LOSS).most_accurate
        sentences.append(_effect(longer, f"twice the time ({minutes(double)})"))
    except ValueError:  # even twice the time pays for no measurement
        pass
    finer = [_half_noise(option) for option in task.request.options]
    precise = task.search(options=finer, beam=NARROW_SHARE, loss=ANY_LOSS).most_accurate
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
    covariance = task.covariance_of_all()
    value = task.goal.value(covariance)
    if value <= 1.0:
        return (
            "All readings of all measurements together would reach it if none were lost"
            f" ({value:.3g} of the target)."
        )
    shares = zip(task.goal.names, task.goal.accuracy(covariance), strict=True)
    missed = [name for name, share in shares if share > 1.0]
    all_missed = ", ".join(missed_accuracy(task, covariance, name) for name in missed)
    return (
        "Even all readings of all measurements together miss it by a factor of"
        f" {value:.3g}: it takes a set-up or an instrument that sees what these do not"
        f" ({all_missed})."
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
    candidates = option.candidates
    finer = dataclasses.replace(candidates, blocks=2.0 * candidates.blocks)
    return dataclasses.replace(option, candidates=finer)


# Sequences of measurements from the study, compared with the best plan of their time.
#
# A sequence takes all readings of each measurement. Where they take longer than the
# budget, it takes the best readings within it.

SAME_VALUE = 1e-6  #: share by which times and values may differ and count as the same


def compare_sequence(
    task: PlanTask, names: Sequence[str], search: PlanSearchResult
) -> result.SequenceRecord:
    """A sequence beside the best plan of its time. Raises InputError for too little."""
    options = [task.request.option(name) for name in names]
    # all candidates of each measurement, one measurement after the other
    sequence = task.predict(
        [(option, np.arange(len(option.candidates))) for option in options]
    )
    seconds = sequence.seconds
    if seconds > task.budget * (1.0 + SAME_VALUE):
        sequence = _keep_within_budget(task, names, search)
        seconds = task.budget
    if abs(seconds - task.budget) > SAME_VALUE * task.budget:
        try:
            search = task.search(seconds * (1.0 + SAME_VALUE))
        except ValueError as error:
            raise InputError(
                str(error), "compare a sequence that takes longer", field="plan.compare"
            ) from error
    best = min(search.most_accurate, sequence, key=lambda plan: plan.value)
    bound = search.bound.value
    readings = [s for stage in sequence.stages for s in stage.series]
    measurement = task.resolved.measurement_with({s.setup for s in readings})
    explained = Assessment.of(measurement, readings)
    singular_values = explained.identifiability.identifiable_singular_values
    chosen = sum(len(stage.chosen) for stage in sequence.stages)
    lost = sum((1.0 - stage.probability).sum() for stage in sequence.stages)
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
        lost=float(lost) / chosen,
        plan=task.record(best),
        gain=_gain(task, sequence, best),
        bound=bound,
        words=_sentence(task, sequence, best, bound, seconds),
    )


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


def _gain(task: PlanTask, sequence: StagePlan, best: StagePlan) -> dict[str, float]:
    """Factor by which the best plan is more accurate, for each component."""
    after = task.accuracy_after(best)
    return {
        name: value / after[name]
        for name, value in task.accuracy_after(sequence).items()
        if after.get(name, 0.0) > 0.0
    }


def _sentence(
    task: PlanTask, sequence: StagePlan, best: StagePlan, bound: float, seconds: float
) -> str:
    time = minutes(seconds)
    if best is sequence or sequence.value < best.value * (1.0 + SAME_VALUE):
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
    without = task.record(task.predict(same_readings))
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
            effects=gap.named_effects(task.table.effects, location),
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

LEFT_OUT = 4  #: largest number of measurements that are left out of the plan in turn
MIN_LOST = 0.05  #: share of lost readings from which a reason mentions it
TIE_TOLERANCE = 5e-4  #: relative difference of accuracy that counts as none
BEAM_WIDTH = 2  #: beam of the searches


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
            beam=BEAM_WIDTH,
            loss=ANY_LOSS,
        )
    except ValueError:  # mounting alone takes longer
        return None
    return search.most_accurate


def why_not(task: PlanTask, plan: StagePlan, best: StagePlan) -> str:
    """What speaks against a plan: lost readings, missed targets, accuracy, time."""
    losses = [(stage.lost_share, stage.option.name) for stage in plan.stages]
    share, name = max(losses, default=(0.0, ""))
    usual = max((stage.lost_share for stage in best.stages), default=0.0)
    reasons = []  # readings that it loses as it lacks a rough stage
    if share > MIN_LOST and share > 2.0 * usual:
        reasons = [
            f"a rough stage is missing: {percent(share)} of the readings of {name} would"
            " be lost"
        ]
    if task.goal.has_targets and plan.value > 1.0:
        covariance = task.covariance_after(plan)
        worst = int(np.argmax(task.goal.accuracy(covariance)))
        missed = missed_accuracy(task, covariance, task.goal.names[worst])
        return "; ".join([*reasons, f"reaches {missed}"])
    accuracy = _accuracy_difference(plan, best)
    time = time_difference(plan.seconds, best.seconds)
    return "; ".join([*reasons, f"{accuracy} {time}"])


def _accuracy_difference(plan: StagePlan, best: StagePlan) -> str:
    worse = plan.value / best.value - 1.0
    if worse > 1.0:
        return f"{worse + 1.0:.3g} times less accurate"
    if worse > TIE_TOLERANCE:
        return f"{percent(worse)} less accurate"
    if worse < -TIE_TOLERANCE:
        return more_accurate(best.value, plan.value)
    return "as accurate"


NO_GAIN = 5e-4  #: relative gain below which a further measurement does not help


def compute_plan(
    state: RunState, request: PlanRequest, earlier: EarlierSession | None
) -> PlanOutcome:
    """The plan that a study requests.

    earlier   session before; the state is then about the machine as identified there

    Raises InputError where the time pays for no measurement.
    """
    progress, seed = state.progress, Stream.PLAN.key(state.seed)
    task = build_task(state.resolved, request, seed, earlier)
    search = _search(task, progress)
    best = drop_small_stages(task, search)
    outcome = build_outcome(task, search, best)
    stages = outcome.section.stages
    if task.table.virtual_machines:
        rng = state.rng(Stream.CAMPAIGN)
        progress.stage("virtual machines through the plan")
        machines = task.realise(best, task.table.virtual_machines, rng, progress.share)
        realised = []
        for record, stage in zip(stages, machines.stages, strict=True):
            ratios = zip(machines.names, stage.ratio, strict=True)
            realised.append(
                replace(
                    record,
                    realised={name: float(v) for name, v in ratios if np.isfinite(v)},
                    realised_lost=stage.realised_loss * (record.chosen or 0),
                    coverage=stage.coverage,
                )
            )
        stages = realised
    sequences = task.request.compare
    section = replace(
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


# -- where to stop ---------------------------------------------------------------------
def drop_small_stages(task: PlanTask, search: PlanSearchResult) -> StagePlan:
    """The best plan without last stages of little worth, or nearly as good a shorter one."""
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
        longer_gain = percent(1.0 - search.best.value / best.value)
        names = ", then ".join(search.best.names)
        return (
            f"after these {len(best.stages)}; {len(search.best.stages)} stages ({names}) would"
            f" make errors {longer_gain} smaller, less than the {percent(task.table.worth)} that"
            " the study asks for."
        )
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


# Phrases about plans: shares, factors and differences of time.
def percent(share: float) -> str:
    """A share in percent, with one decimal below 10 %."""
    return f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.1f} %"


def more_accurate(value: float, better: float) -> str:
    """How much more accurate `better` is than `value`: a share, or a factor from 2."""
    ratio = value / better
    if ratio >= 2.0:
        return f"{ratio:.3g} times as accurate"
    return f"{percent(ratio - 1.0)} more accurate"


def loss_bound_text(loss: float) -> str:
    """How much better than a plan the best possible one can be, given the loss."""
    if loss < 1.0:
        return f"{percent(loss)} better"
    return f"{loss + 1.0:.3g} times as accurate"


def minutes(seconds: float) -> str:
    """A time in whole minutes."""
    return f"{units.number(seconds, 'min'):.0f} min"


def time_difference(seconds: float, other: float) -> str:
    """How much longer or shorter a time is than another one, s."""
    difference = abs(seconds - other)
    if difference < 0.02 * other:
        return "in the same time"
    return f"in {minutes(difference)} {'less' if seconds < other else 'more'}"


def accuracies(values: Mapping[str, float]) -> str:
    """Accuracies by component and unit (`z_um`), as a list."""
    parts = []
    for key, value in values.items():
        component, _, unit = key.rpartition("_")
        parts.append(f"{component} {value:.3g} {unit}")
    return "; ".join(parts)


# -- the plan in headline sentences ----------------------------------------------------
def plan_sentences(section: result.PlanSection | None) -> list[str]:
    """The plan as headline sentences; none where it was not searched for."""
    if section is None or section.value is None or not section.stages:
        return []
    names = ", then ".join(f"{s.measurement} ({s.chosen})" for s in section.stages)
    lines = [
        f"Plan of {section.cost:.0f} min: {names}; it leaves"
        f" {accuracies(section.accuracy)} rms over the workspace."
    ]
    if section.goal and section.reached:
        lines.append("The target accuracy is reached.")
    elif section.goal:
        lines.append(" ".join(section.needs))
    if section.loss is not None:
        lines.append(
            f"No plan within {section.budget_min:.0f} min is more than"
            f" {loss_bound_text(section.loss)}: a bound over all plans that take each"
            " measurement at most as often as `counts` allows."
        )
    if section.effects is not None:
        lines.append(section.effects.words)
    return lines


# The plan as a section of the result: one record a stage, value, bound and front.

#: posterior over prior standard deviation from which a parameter counts as unidentified
MAX_SD_RATIO = 0.95


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanOutcome:
    """The plan with its readings in working order."""

    section: result.PlanSection  #: of the result
    measurement: Measurement  #: with all set-ups of the plan
    series: tuple[Series, ...]  #: all readings
    #: readings of each stage, thermal references among them
    scheduled: tuple[tuple[Series, ...], ...]


def build_outcome(
    task: PlanTask, search: PlanSearchResult, best: StagePlan
) -> PlanOutcome:
    """The plan `best` with its section, without comparisons and texts."""
    arranged = [_arrange(task, stage, k) for k, stage in enumerate(best.stages)]
    series = [s for stage in arranged for s in stage.series]
    judged = search.most_accurate if task.goal.has_targets else best
    records = []
    readings: list[Series] = []
    clock = 0.0
    for planned_stage, ordered in zip(best.stages, arranged, strict=True):
        readings.extend(ordered.series)
        measurement = task.resolved.measurement_with({s.setup for s in readings})
        cumulative = Assessment.of(measurement, readings)
        records.append(_stage_record(task, planned_stage, ordered, clock, cumulative))
        clock += units.number(planned_stage.seconds, "min")
    section = result.PlanSection(
        stages=records,
        cost=units.number(best.seconds, "min"),
        alternatives=[],
        budget_min=units.number(task.budget, "min"),
        price=best.price,
        value=best.value,
        goal=dict(task.table.wanted),
        reached=search.reached,
        start_accuracy=task.accuracy(task.start),
        accuracy=task.accuracy_after(best),
        best_reachable=task.accuracy_after(search.most_accurate),
        bound=search.bound.value,
        loss=max(judged.value / search.bound.value - 1.0, 0.0),
        lines=search.bound.lines,
        front=[task.record(plan) for plan in search.front],
    )
    return PlanOutcome(
        section=section,
        measurement=task.resolved.measurement_with({s.setup for s in series}),
        series=tuple(series),
        scheduled=tuple(stage.scheduled for stage in arranged),
    )


def _arrange(task: PlanTask, stage: PlanStage, number: int) -> order.OrderedPlan:
    """A stage's readings in working order."""
    design = task.resolved.study.design
    measured = next(t for t in task.table.measurement if t.name == stage.option.name)
    usual = design.order if design else DesignTable().order
    table = DesignTable(order=usual, whole_runs=measured.whole_runs)
    location = task.resolved.study.location.key("design")
    rng = task.stage_generator(number)
    measurement = stage.option.measurement
    return order.order_plan(table, location, measurement, (), stage.series, rng)


def _stage_record(
    task: PlanTask,
    stage: PlanStage,
    ordered: order.OrderedPlan,
    begin_min: float,
    cumulative: Assessment,
) -> result.StageRecord:
    """One stage; `cumulative` is the verdict on all readings up to it."""
    verdict = Assessment.of(stage.option.measurement, stage.series).identifiability
    accuracy = task.accuracy(stage.covariance)
    duration_min = units.number(stage.seconds, "min")
    measurement = stage.option.measurement
    names = [measurement.names[k] for k in _free_parameters(stage)]
    ratio = np.sqrt(np.diag(stage.covariance) / np.diag(task.start))[: len(names)]
    pairs = zip(names, ratio, strict=True)
    alone = [name for name, value in pairs if value > MAX_SD_RATIO]
    unit = {p.name: p.unit for p in cumulative.measurement.parameters}
    combinations = []
    for terms in cumulative.identifiability.coefficients_by_name(
        cumulative.identifiability.lost
    ):
        if set(terms) <= set(names) and not set(terms) <= set(alone):
            combinations.append(combination_text(terms, unit))
    unidentified = [*alone, *combinations]
    return result.StageRecord(
        measurement=stage.option.name,
        setups=ordered.summary.setups,
        readings=sum(len(s) for s in stage.series),
        identifies=verdict.rank,
        cost=duration_min,
        kappa=CRITERIA.index("kappa", verdict.identifiable_singular_values),
        predicted=accuracy,
        chosen=len(stage.chosen),
        begin_min=begin_min,
        end_min=begin_min + duration_min,
        price=stage.option.price,
        operator=stage.option.operator,
        available={
            "least": float(stage.probability.min()),
            "mean": float(stage.probability.mean()),
        },
        lost=float((1.0 - stage.probability).sum()),
        cut_off_um=_largest_residual_um(stage),
        rank=cumulative.identifiability.rank,
        parameters=_standard_deviations(stage),
        unidentified=unidentified,
        accuracy=accuracy,
    )


def _largest_residual_um(stage: PlanStage) -> float | None:
    """Largest linearisation residual of a length, um; None where there is none."""
    lengths = stage.linearisation_rms[_is_length(stage)]
    if not lengths.size or not np.isfinite(lengths.max()):
        return None
    return units.number(lengths.max(), "um")


def _is_length(stage: PlanStage) -> Array:
    """Which numbers of a stage's readings (readings,) are lengths."""
    setups = stage.option.measurement.setups
    masks = []
    for s in stage.series:
        channels = setups[s.setup].instrument.channels
        is_length = np.array([channel.unit == "m" for channel in channels])
        masks.append(np.tile(is_length, len(s)))
    return np.concatenate(masks)


def _free_parameters(stage: PlanStage) -> list[int]:
    measurement = stage.option.measurement
    machine_parameters = len(measurement.machine.parameters)
    return [int(k) for k in np.flatnonzero(measurement.free[:machine_parameters])]


def _standard_deviations(stage: PlanStage) -> dict[str, result.Sd]:
    """Standard deviation of each free parameter after a stage, in its display unit."""
    measurement = stage.option.measurement
    positions = _free_parameters(stage)
    scaled = np.sqrt(np.diag(stage.covariance))[: len(positions)]
    table = {}
    for k, sd in zip(positions, scaled, strict=True):
        unit = units.display(measurement.parameters[k].unit)
        value = float(sd * measurement.tolerance[k])
        table[measurement.names[k]] = result.Sd(units.number(value, unit), unit)
    return table
