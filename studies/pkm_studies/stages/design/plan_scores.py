"""Scores the chosen plan and the reference plans by the study's criterion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec
import numpy as np

from oed.base.arrays import Array
from oed.design import criteria
from oed.identifiability import information
from oed.identifiability.assessment import Assessment, assess
from oed.measurement.measurement import Measurement
from oed.result import PlanScore
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.stages.design.criteria import (
    EIGENVALUES,
    StudyCriteria,
    improvement_factors,
)
from pkm_studies.stages.design.select import ChosenDesign

#: ratios of eigenvalues, which do not grow with the number of readings
RATIOS = {"kappa", "O2", "O4"}


class _Plan(NamedTuple):
    """A plan to score: its name, measurement, and readings with their verdict."""

    name: str
    measurement: Measurement
    identifiability: Assessment


def plan_scores(
    resolved: ResolvedStudy, chosen: ChosenDesign, identifiability: Assessment
) -> list[PlanScore]:
    """Scores of the chosen plan, which comes first, and of comparable reference plans.

    Without tolerances, a reference plan is comparable if it sees as many directions.
    """
    judge = chosen.criteria
    name = judge.table.judged_by
    scores: list[PlanScore] = []
    log_phis: list[float] = []
    for plan in _comparable(resolved, chosen, identifiability):
        series = plan.identifiability.series
        for_value, for_comparison = _judging(resolved, judge, plan.measurement)
        value = judge.score(name, for_value, series)[1]
        log_phis.append(judge.score(name, for_comparison, series)[0])
        scores.append(_score(plan, judge, value))
    reference = scores[1].predicted if len(scores) > 1 else {}
    return [
        _compared(score, scores[0], log_phi - log_phis[0], judge, reference)
        for score, log_phi in zip(scores, log_phis, strict=True)
    ]


def _comparable(
    resolved: ResolvedStudy, chosen: ChosenDesign, identifiability: Assessment
) -> list[_Plan]:
    table = chosen.criteria.table
    plans = [_Plan("chosen", chosen.measurement, identifiability)]
    for reference in resolved.reference_plans:
        measurement = resolved.measurement_with(reference.setups)
        other = assess(measurement, reference.series, table.scaling)
        same_setups = set(reference.setups) <= set(resolved.measurement.setups)
        same_rank = other.identifiability.rank == identifiability.identifiability.rank
        if table.prior or (same_setups and same_rank):
            plans.append(_Plan(reference.name, measurement, other))
    return plans


def _judging(
    resolved: ResolvedStudy, judge: StudyCriteria, measurement: Measurement
) -> tuple[Measurement, Measurement]:
    """Measurements over which a plan's value is computed, and compared with others.

    With tolerances, unused set-ups count too: those of the candidates in the value,
    those of all plans in comparisons. Criteria of eigenvalues, and plans without
    tolerances, are judged over what their own readings concern.
    """
    table = judge.table
    if not table.prior or set(table.criteria) & set(EIGENVALUES):
        return measurement, measurement
    candidates = [*resolved.measurement.setups, *measurement.setups]
    every = [n for plan in resolved.reference_plans for n in plan.setups]
    return (
        _with_setups(resolved, measurement, candidates),
        _with_setups(resolved, measurement, [*candidates, *every]),
    )


def _with_setups(
    resolved: ResolvedStudy, measurement: Measurement, names: list[str]
) -> Measurement:
    """The measurement with further set-ups; its own stay as they are, polished or not."""
    setups = {**resolved.measurement_with(names).setups, **measurement.setups}
    return measurement.with_setups(list(setups.values()))


def _score(plan: _Plan, judge: StudyCriteria, value: float) -> PlanScore:
    table, series = judge.table, plan.identifiability.series
    s = plan.identifiability.identifiability.identifiable_singular_values
    n = sum(len(x) for x in series)
    logdet = float(np.log(s**2).sum())
    if table.prior:
        logdet = _gain(judge.information(plan.measurement, series), plan.measurement)
    return PlanScore(
        name=plan.name,
        n=n,
        criterion=table.judged_by,
        value=value,
        logdet=logdet,
        efficiency=1.0,
        kappa=criteria.kappa(s),
        observability=criteria.observability(s, n),
        predicted=judge.predicted_accuracy(plan.measurement, series),
    )


def _gain(total: Array, measurement: Measurement) -> float:
    """Log determinant of an information (n, n) over that of the prior in it."""
    prior = information.prior_information(measurement)
    return float(np.linalg.slogdet(total)[1] - np.linalg.slogdet(prior)[1])


def _compared(
    score: PlanScore,
    best: PlanScore,
    log_phi: float,
    judge: StudyCriteria,
    reference: Mapping[str, float],
) -> PlanScore:
    """With its efficiency against the chosen plan, and its gain over a reference."""
    table = judge.table
    grows = not set(table.criteria) & RATIOS
    per_reading = best.n / score.n if grows and not table.prior else 1.0
    gain = improvement_factors(reference, score.predicted) if reference else {}
    return msgspec.structs.replace(
        score, efficiency=float(np.exp(log_phi)) * per_reading, gain=gain
    )
