"""The time that a plan takes, and the plan section of a study without [plan]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from oed.design import CRITERIA
from oed.identifiability import Assessment
from oed.measurement import Measurement, Series
from oed.result import AlternativePlan, PlanSection, StageRecord
from pkm_studies.resolve import ResolvedStudy


def plan_seconds(measurement: Measurement, series: Sequence[Series]) -> float:
    """Time to mount the set-ups and take the readings of a plan, s."""
    setups = dict.fromkeys(s.setup for s in series)
    mounting = sum(measurement.setups[n].instrument.cost.setup for n in setups)
    return mounting + sum(measurement.reading_seconds(s.setup) * len(s) for s in series)


def single_stage_plan(
    resolved: ResolvedStudy,
    identifiability: Assessment,
    predicted: Mapping[str, float],
) -> PlanSection:
    """The readings as one stage, with their cost in minutes."""
    measurement, series = identifiability.measurement, identifiability.series
    verdict = identifiability.identifiability
    setups = list(dict.fromkeys(s.setup for s in series))
    instruments = [measurement.setups[n].instrument.name for n in setups]
    stage = StageRecord(
        measurement=", ".join(dict.fromkeys(instruments)),
        setups=setups,
        readings=sum(len(s) for s in series),
        identifies=verdict.rank,
        cost=plan_seconds(measurement, series) / 60.0,
        kappa=CRITERIA.index("kappa", verdict.identifiable_singular_values),
        predicted=dict(predicted),
    )
    references: list[str | AlternativePlan] = [
        plan.name for plan in resolved.reference_plans
    ]
    return PlanSection([stage], stage.cost, references)
