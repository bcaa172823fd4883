"""Steps that plan readings: design, plan of stages, identifiability, drawing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed.design import CRITERIA
from oed.identifiability import Assessment, Scaling, assess, explain
from oed.measurement import Measurement, Series
from oed.result import IdentifiabilitySection, PolishSummary
from pkm_studies import describe
from pkm_studies.base import Stream
from pkm_studies.resolve import PlanRequest
from pkm_studies.stages import headline
from pkm_studies.stages.design import section, select
from pkm_studies.stages.plan.earlier import EarlierSession
from pkm_studies.stages.plan.plan import compute_plan
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.stages.run_state import RunState, ScheduledT

# Reports which parameters the readings identify: the section `identifiability`.

SeriesWithMeasurement = tuple[Measurement, Sequence[Series]]


def identifiability_section(
    identifiability: Assessment,
    scaling: Scaling,
    others: Mapping[str, SeriesWithMeasurement],
    indices: Sequence[str] = (),
) -> IdentifiabilitySection:
    """Rank, singular values, null directions, sentences and the named indices.

    `others` are readings that the sentences may recommend as a remedy.
    """
    verdict = identifiability.identifiability
    return IdentifiabilitySection(
        parameters=list(verdict.names),
        n=len(verdict.names),
        rank=verdict.rank,
        tolerance=verdict.tolerance,
        scaling=scaling,
        singular_values=[float(v) for v in verdict.singular_values],
        combinations=verdict.coefficients_by_name(verdict.combinations),
        lost=verdict.coefficients_by_name(verdict.lost),
        words=explain(identifiability, others),
        indices={n: _index(identifiability, n) for n in indices if verdict.rank},
    )


def _index(assessment: Assessment, name: str) -> float:
    """An observability index over the directions that the readings determine."""
    s = assessment.identifiability.identifiable_singular_values
    count_of = _poses if CRITERIA[name].index_of_poses else _readings
    return CRITERIA.index(
        name, s, sum(count_of(assessment, x) for x in assessment.series)
    )


def _readings(assessment: Assessment, series: Series) -> int:
    """Number of readings."""
    return len(series)


def _poses(assessment: Assessment, series: Series) -> int:
    """Number of poses on the runs, references included, a teach pose not."""
    taught = assessment.measurement.setups[series.setup].teach is not None
    poses = series.index[:, 0] if taught else series.index
    return len(np.unique(poses))


def identifiable_variants(
    measurement: Measurement,
    series: Sequence[Series],
    references: Mapping[str, SeriesWithMeasurement],
    scaling: Scaling,
    indices: Sequence[str] = (),
) -> dict[str, IdentifiabilitySection]:
    """Sections for each reference plan, and for each set-up of the plan alone."""
    sections = {}
    for name, (reference_measurement, reference_series) in references.items():
        identifiability = assess(reference_measurement, reference_series, scaling)
        sections[name] = identifiability_section(identifiability, scaling, {}, indices)
    by_setup: dict[str, list[Series]] = {}
    for s in series:
        by_setup.setdefault(s.setup, []).append(s)
    if len(by_setup) < 2:
        return sections
    for name, alone in by_setup.items():
        others = {n: (measurement, s) for n, s in by_setup.items() if n != name}
        identifiability = assess(measurement, alone, scaling)
        sections[f"{name} alone"] = identifiability_section(
            identifiability, scaling, others, indices
        )
    return sections


#: of a study with both tables: which file and which number belong to which
PLAN_AND_DESIGN = (
    "the study has [[plan.measurement]] and [[design.candidates]]: poses.csv, the"
    " measurement sheet and plan_poses.json hold the plan; identifiability, estimate"
    " and accuracy are those of the design, whose poses the report lists"
)


def select_design(state: RunState) -> RunState:
    """Choose the readings of [design], if any; from here on, only its set-ups count."""
    state.progress.stage("design")
    design = select.select_design(state.resolved, state.rng(Stream.DESIGN))
    if design is None:
        return state
    return state.replace(
        design=design, planned=design.scheduled, measurement=design.measurement
    ).add_warnings(*_moved_setups(design.polish))


def _moved_setups(polish: PolishSummary | None) -> list[str]:
    """A warning for each set-up that polishing moved."""
    warnings = []
    for name, settings in (polish.setups if polish else {}).items():
        values = ", ".join(f"{key} = {value:.6g}" for key, value in settings.items())
        warnings.append(
            f"polishing moved set-up {name}: write {values} into its table before you"
            " fit its readings"
        )
    return warnings


def plan_stages(state: RunState) -> RunState:
    """Plan the measurements of [plan], if any; without a design, its readings count."""
    if state.resolved.plan is None:
        return state
    return plan_measurements(state, state.resolved.plan, None)[0]


def plan_measurements(
    state: RunState, request: PlanRequest, earlier: EarlierSession | None
) -> tuple[RunState, PlanOutcome]:
    """The state with the plan that is requested, and the plan.

    `earlier` is what an earlier session identified.
    """
    state.progress.stage("plan")
    outcome = compute_plan(
        state.resolved,
        request,
        Stream.PLAN.key(state.seed),
        state.rng(Stream.CAMPAIGN),
        state.progress,
        earlier,
    )
    state = state.replace(plan=outcome).add_sections(plan=outcome.section)
    planned = tuple(series for stage in outcome.scheduled for series in stage)
    state = state.replace(planned=planned)
    if state.design is not None:
        return state.add_warnings(PLAN_AND_DESIGN), outcome
    if state.resolved.dataset is not None:
        return state, outcome
    return state.replace(measurement=outcome.measurement), outcome


def analyse_identifiability(state: ScheduledT) -> ScheduledT:
    """Find which parameters the readings identify, alone and against other plans."""
    state.progress.stage("identifiability")
    resolved, series = state.resolved, state.readings.series
    scaling: Scaling = state.study.design.scaling if state.study.design else "length"
    indices = state.study.design.indices if state.study.design else ()
    references = {
        plan.name: (resolved.measurement_with(plan.setups), plan.series)
        for plan in resolved.reference_plans
    }
    used = {s.setup for s in series}
    others = {
        plan.name: references[plan.name]
        for plan in resolved.reference_plans
        if not set(plan.setups) <= used
    }
    verdict = assess(state.measurement, series, scaling)
    return state.replace(identifiability=verdict).add_sections(
        identifiability=identifiability_section(verdict, scaling, others, indices),
        identifiability_of=identifiable_variants(
            state.measurement, series, references, scaling, indices
        ),
        kappa_maps=[select.kappa_map(c, scaling) for c in resolved.kappa_circles],
    )


def report_design(state: ScheduledT) -> ScheduledT:
    """Score the chosen design, whose identifiability is known, beside reference plans."""
    verdict = state.identifiability
    if state.design is None or verdict is None:
        return state
    scored = section.design_section(state.resolved, state.design, verdict)
    return state.add_sections(design=scored)


def report_single_stage(state: ScheduledT) -> ScheduledT:
    """Report the readings as one stage, where the study has no [plan]."""
    verdict = state.identifiability
    if state.plan is not None or verdict is None:
        return state
    predicted = headline.predicted_accuracy(state.result.prediction)
    stage = select.single_stage_plan(state.resolved, verdict, predicted)
    return state.add_sections(plan=stage)


def draw_machine(state: ScheduledT) -> ScheduledT:
    """Lay out the machine at home and the tool points of the readings."""
    drawing = describe.drawing(state.measurement, state.readings.series)
    return state.add_sections(drawing=drawing)
