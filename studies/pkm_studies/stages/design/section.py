"""The step that chooses a design, and its section of the result."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from oed.design import CRITERIA, Criterion
from oed.identifiability import Assessment, Scaling, explain, prior_information
from oed.measurement import Measurement, Series
from oed.result import (
    DesignSection,
    IdentifiabilitySection,
    PlannedReading,
    PlanScore,
    RobustSummary,
)
from oed.text import guaranteed_percent
from pkm_studies import describe
from pkm_studies.base import Stream
from pkm_studies.describe import displayed_command, displayed_joints, displayed_values
from pkm_studies.resolve import ResolvedStudy
from pkm_studies.stages import headline
from pkm_studies.stages.design import select
from pkm_studies.stages.design.criteria import StudyCriteria, improvement_factors
from pkm_studies.stages.design.select import ChosenDesign, plan_seconds
from pkm_studies.stages.plan.plan import compute_plan
from pkm_studies.stages.plan.task import EarlierSession
from pkm_studies.stages.run_state import RunState, ScheduledT


# Scores the chosen plan and the reference plans by the study's criterion.
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
    plans = [_Plan("chosen", chosen.measurement, identifiability)]
    for given in resolved.reference_plans:
        measurement = resolved.measurement_with(given.setups)
        other = Assessment.of(measurement, given.series, judge.table.scaling)
        same_setups = set(given.setups) <= set(resolved.measurement.setups)
        same_rank = other.identifiability.rank == identifiability.identifiability.rank
        if judge.table.prior or (same_setups and same_rank):
            plans.append(_Plan(given.name, measurement, other))
    for plan in plans:
        series = plan.identifiability.series
        for_value, for_comparison = _judging(resolved, judge, plan.measurement)
        value = judge.score(name, for_value, series)[1]
        log_phis.append(judge.score(name, for_comparison, series)[0])
        scores.append(_score(plan, judge, value))
    reference = scores[1].predicted if len(scores) > 1 else {}
    # ratios of eigenvalues do not grow with the number of readings
    grows = all(form.concave for form in _forms(judge)) and not judge.table.prior
    compared = []
    for score, log_phi in zip(scores, log_phis, strict=True):
        per_reading = scores[0].n / score.n if grows else 1.0
        efficiency = float(np.exp(log_phi - log_phis[0])) * per_reading
        gain = improvement_factors(reference, score.predicted) if reference else {}
        compared.append(replace(score, efficiency=efficiency, gain=gain))
    return compared


def _judging(
    resolved: ResolvedStudy, judge: StudyCriteria, measurement: Measurement
) -> tuple[Measurement, Measurement]:
    """Measurements over which a plan's value is computed, and compared with others.

    With tolerances, unused set-ups count too: those of the candidates in the value,
    those of all plans in comparisons. Criteria of eigenvalues, and plans without
    tolerances, are judged over what their own readings concern.
    """
    if not judge.table.prior or any(form.spectral for form in _forms(judge)):
        return measurement, measurement

    def with_setups(names: list[str]) -> Measurement:
        """The measurement with further set-ups; its own stay as they are, polished or not."""
        setups = {**resolved.measurement_with(names).setups, **measurement.setups}
        return measurement.with_setups(list(setups.values()))

    candidates = [*resolved.measurement.setups, *measurement.setups]
    every = [n for plan in resolved.reference_plans for n in plan.setups]
    return with_setups(candidates), with_setups([*candidates, *every])


def _forms(judge: StudyCriteria) -> list[Criterion]:
    """The study's criteria, to ask for their properties."""
    return [CRITERIA[name].properties for name in judge.table.criteria]


def _score(plan: _Plan, judge: StudyCriteria, value: float) -> PlanScore:
    table, series = judge.table, plan.identifiability.series
    s = plan.identifiability.identifiability.identifiable_singular_values
    n = sum(len(x) for x in series)
    logdet = float(np.log(s**2).sum())
    if table.prior:
        prior = prior_information(plan.measurement)
        logdet = float(
            np.linalg.slogdet(judge.information(plan.measurement, series))[1]
            - np.linalg.slogdet(prior)[1]
        )
    return PlanScore(
        name=plan.name,
        n=n,
        criterion=table.judged_by,
        value=value,
        logdet=logdet,
        efficiency=1.0,
        kappa=CRITERIA.index("kappa", s),
        observability=CRITERIA.observability(s, n),
        predicted=judge.predicted_accuracy(plan.measurement, series),
    )


#: slack of the bound (log of an efficiency) from which it is worth saying
MIN_STATED_SLACK = 0.01


def design_section(
    resolved: ResolvedStudy, chosen: ChosenDesign, identifiability: Assessment
) -> DesignSection:
    """The chosen plan with its certificate, scored with the reference plans."""
    table, choice, polish = chosen.criteria.table, chosen.choice, chosen.polish
    scores = plan_scores(resolved, chosen, identifiability)
    # columns that stand for the common errors of runs, not for parameters
    shared = max(choice.columns - int(resolved.measurement.free.sum()), 0)
    allowed = chosen.effects
    if allowed is not None:
        recording = select.recording(chosen.criteria, chosen.measurement, chosen.series)
        allowed = replace(allowed, recording=recording)
    moved = polish is not None and polish.after != polish.before
    value = choice.value
    if polish is not None and moved:
        value = polish.after
    elif chosen.retained:
        value = scores[0].value
    return DesignSection(
        criterion=table.judged_by,
        n=scores[0].n,
        value=value,
        bound=None if moved else choice.bound,
        efficiency=None if moved else choice.efficiency,
        kappa=scores[0].kappa,
        observability=scores[0].observability,
        poses=planned_readings(chosen.measurement, chosen.scheduled),
        scaling=table.scaling,
        candidates=chosen.candidates,
        plans=scores,
        words=certificate_text(chosen, shared),
        directions=choice.directions - shared,
        columns=choice.columns - shared,
        gap=None if moved else choice.duality_gap,
        proven=choice.proven and not moved,
        compound=dict(table.compound),
        setups=chosen.order.setups,
        retained=chosen.retained,
        cost_min=plan_seconds(chosen.measurement, chosen.series) / 60.0,
        refused=dict(resolved.refusals),
        compared=list(chosen.compared),
        polished=chosen.polish,
        order=chosen.order,
        robust=chosen.robust,
        how_many=chosen.how_many,
        relaxed=chosen.relaxed,
        effects=allowed,
    )


def planned_readings(
    measurement: Measurement, series: Sequence[Series]
) -> list[PlannedReading]:
    """The readings as poses to command, in working order, with their nominal values."""
    planned = []
    for s in series:
        instrument = measurement.setups[s.setup].instrument
        channels = instrument.channels
        expected = measurement.expected_readings(s)
        y = expected.reshape(len(s), len(channels))
        commands = s.reading_commands()
        joints = s.q[s.index[:, 0]]
        number: Counter[str] = Counter()
        for k, run in enumerate(s.run):
            number[run] += 1
            sent = displayed_joints(measurement.machine, joints[k])
            read = displayed_values(channels, y[k])
            reading = PlannedReading(
                setup=s.setup,
                run=str(run),
                order=number[run],
                command=displayed_command(measurement.machine, commands[k]),
                # what is recorded of a constraint are the joints at which it holds
                reading=read if instrument.implied is None else sent,
                joints=sent,
            )
            planned.append(reading)
    return planned


# -- how good the plan is known to be --------------------------------------------------
def certificate_text(chosen: ChosenDesign, shared: int = 0) -> str:
    """The certificate, its scope, and what polishing added; without `shared` columns."""
    kind = "runs" if chosen.criteria.table.whole_runs else "readings"
    what = f"{len(chosen.choice.indices)} of {chosen.candidates} {kind}"
    text = _certificate(chosen, what)
    text += _directions(chosen, shared)
    table = chosen.criteria.table
    count = len(chosen.choice.indices)
    wanted = table.size
    shortfall = ""
    if wanted is not None and count < wanted and table.budget_min is None:
        shortfall = (
            f"; the study asks for {wanted}, but the rules leave no room for more"
        )
    text += shortfall
    if chosen.relaxed is not None:
        text += ": the largest of the relaxation's weights"
    if chosen.retained:
        text += f", added to {chosen.retained} retained readings"
    polish = chosen.polish
    if polish is None:
        return f"{text}."
    return f"{text}. Then, off the grid, {polish.words}."


def _certificate(chosen: ChosenDesign, what: str) -> str:
    choice = chosen.choice
    if chosen.robust is not None:
        return _robust_certificate(chosen.robust, what)
    if choice.proven:
        return (
            f"Proven optimal: no other choice of {what} is better by {choice.criterion}"
        )
    if choice.efficiency is None:
        return (
            f"The best choice of {what} that the search found; no bound is known for"
            f" {choice.criterion} under these rules"
        )
    share = guaranteed_percent(choice.efficiency)
    text = f"Certified to {share:.1f} % of the best possible choice of {what}"
    if chosen.bound_ignores_setups:
        text += (
            " (the bound allows any number of set-ups: the choice is better than this"
            " figure)"
        )
    elif choice.duality_gap is not None and choice.duality_gap > MIN_STATED_SLACK:
        text += (
            f" (the bound itself may be {100 * choice.duality_gap:.0f} % too high: the choice"
            " is better than this figure)"
        )
    return text


def _directions(chosen: ChosenDesign, shared: int) -> str:
    """The scope, where the candidates do not see all parameters."""
    visible = chosen.choice.directions - shared
    columns = chosen.choice.columns - shared
    if visible >= columns:
        return ""
    text = (
        f", over the {visible} of {columns} directions that the candidates see (the"
        " identifiable subspace)"
    )
    if chosen.choice.weak:
        text += (
            f"; {chosen.choice.weak} of the directions left out are seen, but at least a"
            " million times worse than the best one: they count as not seen"
        )
    return text


def _robust_certificate(robust: RobustSummary, what: str) -> str:
    risk = {
        "mean": "on average",
        "cvar": f"over the worst {guaranteed_percent(robust.level):.1f} %",
        "worst": "for the worst one",
    }
    share = guaranteed_percent(robust.efficiency)
    gain = 100.0 * (np.exp(robust.value - robust.nominal) - 1.0)
    return (
        f"Chosen for {robust.scenarios} machines drawn from the tolerances,"
        f" {risk[robust.risk]}: certified to {share:.1f} % of the best possible choice of"
        f" {what} for them, and {gain:.1f} % better there than the plan for the nominal"
        " machine"
    )


# Reports which parameters the readings identify: the section `identifiability`.

SeriesWithMeasurement = tuple[Measurement, Sequence[Series]]


def identifiability_section(
    identifiability: Assessment,
    scaling: Scaling,
    others: Mapping[str, SeriesWithMeasurement],
    indices: Sequence[str] = (),
) -> IdentifiabilitySection:
    """Rank, singular values, directions, named indices, and remedies from `others`."""
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
    of_poses = CRITERIA[name].index_of_poses
    counts = [_poses(assessment, x) if of_poses else len(x) for x in assessment.series]
    return CRITERIA.index(name, s, sum(counts))


def _poses(assessment: Assessment, series: Series) -> int:
    """Number of poses on the runs, references included, a teach pose not."""
    taught = assessment.measurement.setups[series.setup].teach is not None
    poses = series.index[:, 0] if taught else series.index
    return len(np.unique(poses))


def identifiable_variants(
    state: ScheduledT, references: Mapping[str, SeriesWithMeasurement], scaling: Scaling
) -> dict[str, IdentifiabilitySection]:
    """Sections for each reference plan, and for each set-up of the plan alone."""
    by_setup: dict[str, list[Series]] = {}
    for s in state.readings.series:
        by_setup.setdefault(s.setup, []).append(s)
    plans: dict[str, SeriesWithMeasurement] = {**references}
    others: dict[str, dict[str, SeriesWithMeasurement]] = {}
    if len(by_setup) > 1:
        alone = {n: (state.measurement, series) for n, series in by_setup.items()}
        for name, plan in alone.items():
            plans[f"{name} alone"] = plan
            others[f"{name} alone"] = {n: p for n, p in alone.items() if n != name}
    indices = state.study.design.indices if state.study.design else ()
    return {
        name: identifiability_section(
            Assessment.of(*plan, scaling), scaling, others.get(name, {}), indices
        )
        for name, plan in plans.items()
    }


# Steps that plan readings: design, plan of stages, identifiability, drawing.

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
    warnings = []
    for name, settings in (design.polish.setups if design.polish else {}).items():
        values = ", ".join(f"{key} = {value:.6g}" for key, value in settings.items())
        warnings.append(
            f"polishing moved set-up {name}: write {values} into its table before you"
            " fit its readings"
        )
    return state.replace(
        design=design, planned=design.scheduled, measurement=design.measurement
    ).add_warnings(*warnings)


def plan_stages(state: RunState, earlier: EarlierSession | None = None) -> RunState:
    """Plan the measurements of [plan], if any, after an `earlier` session.

    Without a design, its readings count.
    """
    if state.resolved.plan is None:
        return state
    state.progress.stage("plan")
    outcome = compute_plan(state, state.resolved.plan, earlier)
    planned = tuple(series for stage in outcome.scheduled for series in stage)
    state = state.replace(plan=outcome, planned=planned)
    state = state.add_sections(plan=outcome.section)
    if state.design is not None:
        return state.add_warnings(PLAN_AND_DESIGN)
    if state.resolved.dataset is not None:
        return state
    return state.replace(measurement=outcome.measurement)


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
    verdict = Assessment.of(state.measurement, series, scaling)
    return state.replace(identifiability=verdict).add_sections(
        identifiability=identifiability_section(verdict, scaling, others, indices),
        identifiability_of=identifiable_variants(state, references, scaling),
        kappa_maps=[select.kappa_map(c, scaling) for c in resolved.kappa_circles],
    )


def report_design(state: ScheduledT) -> ScheduledT:
    """Score the chosen design, whose identifiability is known, beside reference plans."""
    verdict = state.identifiability
    if state.design is None or verdict is None:
        return state
    scored = design_section(state.resolved, state.design, verdict)
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
