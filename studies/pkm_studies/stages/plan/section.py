"""The plan as a section of the result: one record a stage, value, bound and front."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed import result, units
from oed.base import Array
from oed.design import CRITERIA
from oed.identifiability import Assessment, assess, combination_text
from oed.measurement import Measurement, Series
from oed.planning import PlanSearchResult, PlanStage, StagePlan
from pkm_studies.stages.design import order
from pkm_studies.stages.plan.task import PlanTask
from pkm_studies.tables import DesignTable

#: posterior over prior standard deviation from which a parameter counts as unidentified
UNIDENTIFIED = 0.95


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanOutcome:
    """The plan with its readings in working order.

    section      of the result
    measurement  with all set-ups of the plan
    series       all readings
    scheduled    readings of each stage, thermal references among them
    """

    section: result.PlanSection
    measurement: Measurement
    series: tuple[Series, ...]
    scheduled: tuple[tuple[Series, ...], ...]


def build_outcome(
    task: PlanTask, search: PlanSearchResult, best: StagePlan
) -> PlanOutcome:
    """The plan `best` with its section, without comparisons and texts."""
    arranged = [_arrange(task, stage, k) for k, stage in enumerate(best.stages)]
    series = [s for stage in arranged for s in stage.series]
    judged = search.most_accurate if task.goal.has_targets else best
    section = result.PlanSection(
        stages=_stage_records(task, best, arranged),
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
    table = _add_order(task, stage.option.name)
    location, rng = (
        task.resolved.study.location.key("design"),
        task.stage_generator(number),
    )
    measurement = stage.option.measurement
    return order.order_plan(table, location, measurement, (), stage.series, rng)


def _add_order(task: PlanTask, name: str) -> DesignTable:
    """[design.order] and the whole runs of a measurement alone."""
    design = task.resolved.study.design
    table = next(t for t in task.table.measurement if t.name == name)
    usual = design.order if design else DesignTable().order
    return DesignTable(order=usual, whole_runs=table.whole_runs)


def _stage_records(
    task: PlanTask, plan: StagePlan, arranged: Sequence[order.OrderedPlan]
) -> list[result.StageRecord]:
    """The stages with their times, one after the other."""
    records = []
    readings: list[Series] = []
    clock = 0.0
    for stage, ordered in zip(plan.stages, arranged, strict=True):
        readings.extend(ordered.series)
        measurement = task.resolved.measurement_with({s.setup for s in readings})
        cumulative = assess(measurement, readings)
        records.append(_stage_record(task, stage, ordered, clock, cumulative))
        clock += units.number(stage.seconds, "min")
    return records


def _stage_record(
    task: PlanTask,
    stage: PlanStage,
    ordered: order.OrderedPlan,
    begin_min: float,
    cumulative: Assessment,
) -> result.StageRecord:
    """One stage; `cumulative` is the verdict on all readings up to it."""
    verdict = assess(stage.option.measurement, stage.series).identifiability
    accuracy = task.accuracy(stage.covariance)
    duration_min = units.number(stage.seconds, "min")
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
        unidentified=_unidentified(task, stage, cumulative),
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
    """Positions of the machine's free parameters."""
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


def _unidentified(
    task: PlanTask, stage: PlanStage, cumulative: Assessment
) -> list[str]:
    """Parameters, then combinations of them, that no reading so far determines."""
    measurement = stage.option.measurement
    names = [measurement.names[k] for k in _free_parameters(stage)]
    ratio = np.sqrt(np.diag(stage.covariance) / np.diag(task.start))[: len(names)]
    pairs = zip(names, ratio, strict=True)
    alone = [name for name, value in pairs if value > UNIDENTIFIED]
    unit = {p.name: p.unit for p in cumulative.measurement.parameters}
    combinations = []
    for terms in cumulative.identifiability.coefficients_by_name(
        cumulative.identifiability.lost
    ):
        if set(terms) <= set(names) and not set(terms) <= set(alone):
            combinations.append(combination_text(terms, unit))
    return [*alone, *combinations]
