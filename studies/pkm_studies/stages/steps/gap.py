"""Steps about the gap: what readings could find, and the diagnosis of what remains."""

from __future__ import annotations

import msgspec

from oed import units
from oed.design import Rules
from oed.measurement import Measurement
from pkm_studies.base import Stream
from pkm_studies.resolve import (
    ALL_EFFECTS,
    NO_EFFECTS,
    GapDesignRequest,
    GapRequest,
    add_planned_readings,
)
from pkm_studies.stages.gap import detectability, second_visit, section
from pkm_studies.stages.gap.virtual_readings import covariates_of, empty_readings
from pkm_studies.stages.run_state import Fitted, RunState, ScheduledT

#: the only advice after a fit that failed its check, where no effect explains it
AFTER_BAD_FIT = (
    "Do not compensate with these parameters: the fit is bad, and no effect explains it."
    " Check the readings and the stated noise first."
)


def preview_gap(state: ScheduledT) -> ScheduledT:
    """Predict what the readings could find, and choose the runs of [gap.design]."""
    request = state.resolved.gap
    if request is None:
        return state
    state.progress.stage("what the readings could find")
    series, covariates = state.readings.series, state.readings.covariates
    if covariates is None:
        planned = empty_readings(state.measurement, series, request)
        series, covariates = planned.series, planned.covariates
    preview = detectability.preview(
        state.measurement,
        series,
        covariates,
        request,
        state.rng(Stream.BEFORE),
        _gap_design(state),
    )
    state = state.replace(gap_poses=preview.poses_csv)
    return state.add_sections(gap_before=preview.section)


def _gap_design(
    state: RunState,
) -> tuple[Measurement, GapDesignRequest, Rules] | None:
    """[gap.design] with a measurement of its set-ups, and the rules of the choice.

    None without the table, and where it waits for a plan that was not made.
    """
    request = state.resolved.gap_design
    if request is not None and request.follows_plan:
        request = _add_plan(state, request)
    if request is None or request.rules is None:
        return None
    setups = {run.setup for run in request.runs}
    return state.resolved.measurement_with(setups), request, request.rules


def _add_plan(state: RunState, request: GapDesignRequest) -> GapDesignRequest | None:
    """The request with the plan's readings retained; None where there is no plan."""
    plan, plan_request = state.plan, state.resolved.plan
    if plan is None or plan_request is None:
        return None
    remaining = plan_request.budget - units.factor("min") * plan.section.cost
    used = {s.setup for s in plan.series} | {run.setup for run in request.runs}
    measurement = state.resolved.measurement_with(used)
    return add_planned_readings(request, plan.series, remaining, measurement)


def diagnose_gap(state: Fitted) -> Fitted:
    """Find which effects cause what calibration leaves.

    Of readings of a machine always, unless the study allows the geometry alone or the
    command names the effects; of those of a virtual machine where the study asks for it.
    """
    is_recorded = state.resolved.dataset is not None
    by_default = ALL_EFFECTS if is_recorded else NO_EFFECTS
    effects = state.study.identify.effects
    is_asked = (by_default if effects is None else effects) not in (NO_EFFECTS, [])
    is_asked = is_asked and not state.with_effects
    if state.resolved.gap is None and not is_asked:
        return state
    return diagnose_always(state)


def diagnose_always(state: Fitted) -> Fitted:
    """Diagnose by [gap], or by its defaults where the study has none."""
    return _diagnose(state, state.resolved.diagnosed)


def _diagnose(state: Fitted, request: GapRequest) -> Fitted:
    readings = state.readings
    if state.checked is not None and state.checked.mistaken:
        reason = (
            "There is no diagnosis: a mistake in the readings explains their misfit"
        )
        return state.add_warnings(reason).withhold_section("gap", reason)
    state.progress.stage("diagnosis")
    covariates = covariates_of(
        state.measurement, readings.series, readings.covariates, request
    )
    diagnosis = section.diagnose(
        state.measurement,
        readings.series,
        readings.y,
        covariates,
        state.estimate.theta,
        request,
        state.rng(Stream.GAP),
    )
    state = state.replace(diagnosis=diagnosis)
    gap = section.gap_section(diagnosis, request.effects)
    if state.fit_is_bad and gap.verdict == "none":
        gap = msgspec.structs.replace(gap, next=[AFTER_BAD_FIT])
    design = state.resolved.gap_design
    further = () if design is None else design.runs
    rng = state.rng(Stream.VISIT)
    visit = second_visit.advise(diagnosis, request, further, rng)
    if visit is None:
        return state.add_sections(gap=gap)
    gap = second_visit.add_visit(gap, visit.record)
    return state.replace(visit_poses=visit.csv).add_sections(gap=gap)
