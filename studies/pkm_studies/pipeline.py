"""Runs a study: the only file that knows in which order the steps follow."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from oed import dataset
from oed.base import own_files
from oed.base.arrays import Array
from oed.dataset.digests import digests
from oed.result import StudyResult
from oed.result.verdict import accuracy_verdicts
from pkm_studies import files, result_folder
from pkm_studies.base import Progress, Silent
from pkm_studies.resolve.counted import counted
from pkm_studies.results import check_claims, load_result
from pkm_studies.stages import describe, headline, run_files
from pkm_studies.stages.plan.earlier import read_earlier_session, stored_knowledge
from pkm_studies.stages.run_state import (
    Fitted,
    Measured,
    Readings,
    RunState,
    Scheduled,
    promote,
    start,
)
from pkm_studies.stages.session_files import with_sessions
from pkm_studies.stages.steps.checks import check_readings
from pkm_studies.stages.steps.correct import correct_for_effects
from pkm_studies.stages.steps.design import (
    analyse_identifiability,
    draw_machine,
    plan_measurements,
    plan_stages,
    report_design,
    report_single_stage,
    select_design,
)
from pkm_studies.stages.steps.fit import fit_parameters, sample_posterior
from pkm_studies.stages.steps.forecast import forecast_errors
from pkm_studies.stages.steps.gap import diagnose_always, diagnose_gap, preview_gap
from pkm_studies.stages.steps.mixture import mix_answers
from pkm_studies.stages.steps.prediction import predict_accuracy, predict_held_out
from pkm_studies.stages.steps.readings import (
    planned_series,
    simulate_readings,
    take_readings,
)
from pkm_studies.study import Study

#: sections that the diagnosis alone and the plan alone make: claims about others wait
DIAGNOSIS_SECTIONS = (
    "gap",
    "corrected",
    "estimate",
    "identifiability",
    "identifiability_of",
)
FORECAST_SECTIONS = ("forecast",)
PLAN_SECTIONS = ("plan", "identifiability", "gap_before")
#: takes a state of a run and returns the next
Step = Callable[[Any], Any]


def run(
    study: Study,
    out: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
    report: bool = True,
    readings: Sequence[Path] | None = None,
    effects: Sequence[str] = (),
) -> StudyResult:
    """Run everything that the study asks for, and write its files into `out`.

    `readings` replace those that the study names. `effects` are estimated together with
    the parameters. Where `out` holds the unfinished
    posterior of an interrupted run with the same study, readings and seed, that is
    resumed. Raises InputError for what cannot be done, IdentificationError where a fit
    fails; what was computed before is then written.
    """
    if _asks_for_forecast_alone(study) and not readings:
        return forecast(study, out, seed=seed, progress=progress)
    state = start(study, seed, progress or Silent(), readings)
    state = state.replace(with_effects=tuple(effects))
    result_folder.prepare(out)
    checkpoint = run_files.checkpoint(out, study, state.seed)
    steps = [select_design, *_unless(state.readings_given, plan_stages), take_readings]
    state = _take(state.replace(checkpoint=checkpoint), steps, out)
    state = _take(state, _evaluation(state), out)
    study_result = _finish(state, out, report=report)
    checkpoint.clear()
    return study_result


def diagnose(
    study: Study,
    readings: Sequence[Path] | None,
    out: Path,
    *,
    after: Path | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Fit readings (the study's own where None), and diagnose what the fit leaves.

    `after` is the folder of an earlier diagnosis: its readings count as well. Raises
    InputError where there are no readings.
    """
    state = start(study, seed, progress or Silent(), readings)
    state = with_sessions(state, readings, after)
    recorded = state.resolved.dataset is not None
    if not recorded and study.readings is None:
        raise study.place.key("readings").error(
            "there are no readings to diagnose", "give --readings FILE.csv"
        )
    result_folder.prepare(out)
    steps: list[Step] = [*_unless(recorded, select_design, plan_stages), take_readings]
    steps += [check_readings, analyse_identifiability, fit_parameters, diagnose_always]
    steps += [correct_for_effects, mix_answers, draw_machine]
    state = _take(state, steps, out)
    return _finish(state, out, report=True, sections=DIAGNOSIS_SECTIONS)


def fit_checked(state: Measured, theta: Array | None = None) -> Fitted:
    """Check readings and what they identify, then fit them. Raises IdentificationError.

    theta  (n,) parameters where the fit begins, SI; nominal by default
    """
    checked = analyse_identifiability(check_readings(state))
    return fit_parameters(checked, theta)


def with_diagnosis(state: Fitted) -> Fitted:
    """The diagnosis of what a fit leaves, and what follows from it."""
    return mix_answers(correct_for_effects(diagnose_always(state)))


def plan(
    study: Study,
    out: Path,
    *,
    after: Path | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Plan the measurements of [plan]; read and fit nothing.

    `after` is the folder of a result: what it identified is known, and its stages are
    done. Raises InputError where the study lists no measurement, or none fits the time.
    """
    result_folder.prepare(out)
    state = planned_state(study, after, seed, progress or Silent())
    return _finish(state, out, report=True, sections=PLAN_SECTIONS)


def forecast(
    study: Study,
    out: Path,
    *,
    readings: Path | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Plan the nodes of [forecast], or fit those that were measured.

    A result in `out` is known, and gets the section. Raises InputError for what the study
    misstates, or the file of nodes.
    """
    result_folder.prepare(out)
    state = start(study, seed, progress or Silent(), [])
    if not (out / result_folder.RESULT).is_file():
        state = forecast_errors(state, None, readings)
        return _finish(state, out, report=True, sections=FORECAST_SECTIONS)
    stored = load_result(out)
    knowledge = stored_knowledge(state.resolved, stored, out)
    state = forecast_errors(state, knowledge, readings)
    result = msgspec.structs.replace(stored, forecast=state.result.forecast)
    checked = check_claims(study, msgspec.to_builtins(result), FORECAST_SECTIONS)
    names = {claim.claim for claim in checked}
    others = [claim for claim in stored.claims if claim.claim not in names]
    result = msgspec.structs.replace(result, claims=[*others, *checked])
    return run_files.add_forecast(out, result, state)


def _asks_for_forecast_alone(study: Study) -> bool:
    others = (study.design, study.plan, study.readings)
    return study.forecast is not None and others == (None, None, None)


def planned_state(
    study: Study, after: Path | None, seed: int | None, progress: Progress
) -> Scheduled:
    """The state of a run with the plan of stages. Raises InputError as `plan` does."""
    state = start(study, seed, progress, [])
    request = state.resolved.plan
    if request is None:
        raise (
            study.place.key("plan")
            .key("measurement")
            .error(
                "the study lists no measurement to plan with",
                "add [[plan.measurement]] tables",
            )
        )
    earlier = None
    if after is not None:
        earlier_result = load_result(after)
        earlier = read_earlier_session(state.resolved, request, after, earlier_result)
        state = state.replace(resolved=earlier.resolved)
        request = earlier.plan
    state, outcome = plan_measurements(state, request, earlier)
    readings = Readings(series=outcome.series)
    scheduled = promote(Scheduled, state, readings=readings)
    scheduled = analyse_identifiability(scheduled)
    if scheduled.identifiability is not None:
        measurement = scheduled.identifiability.measurement
        scheduled = scheduled.replace(measurement=measurement)
    scheduled = draw_machine(scheduled)
    cause = scheduled.resolved.gap_design
    if cause is not None and cause.follows_plan:
        return preview_gap(scheduled)
    return scheduled


def simulate(study: Study, out: Path, *, seed: int | None = None) -> tuple[Path, Path]:
    """Write readings of the study's virtual machine to `out`, and its truth.

    The truth has the same name with the suffix .truth.json; both paths are returned.
    Raises InputError where one of the files exists.
    """
    for path in (out, _truth_path(out)):
        files.check_new(path)
    state = start(study, seed, Silent(), [])
    state = plan_stages(select_design(state))
    virtual = simulate_readings(state, planned_series(state))
    readings, measurement = virtual.readings, state.measurement
    covariates = readings.covariates
    if covariates is not None:
        covariates = covariates.drop(columns=["setup", "run", "order"])
    data = dataset.from_series(readings.series, readings.y, measurement, covariates)
    truth: dict[str, Any] = {
        p.name: {"value": float(value), "unit": p.unit}
        for p, value in zip(measurement.parameters, virtual.truth, strict=True)
    }
    if virtual.effects:
        truth["effects"] = virtual.effects
    text = msgspec.json.format(msgspec.json.encode(truth), indent=1)
    files.write_all({out: dataset.to_csv(data), _truth_path(out): text})
    return out, _truth_path(out)


def _truth_path(readings: Path) -> Path:
    stem = readings.name.removesuffix(".readings.csv").removesuffix(".csv")
    return readings.with_name(f"{stem}.truth.json")


def _evaluation(state: Scheduled) -> list[Step]:
    """From readings to accuracy."""
    only_planned = not isinstance(state, Measured)
    fit = (fit_parameters, sample_posterior, diagnose_gap)
    return [
        *_unless(only_planned, check_readings),
        analyse_identifiability,
        report_design,
        preview_gap,
        *_unless(only_planned, *fit, correct_for_effects, mix_answers),
        predict_accuracy,
        *_unless(only_planned, predict_held_out),
        *_unless(state.study.forecast is None, forecast_errors),
        report_single_stage,
        draw_machine,
    ]


def _unless(left_out: bool, *steps: Step) -> tuple[Step, ...]:
    return () if left_out else steps


def _take(state: RunState, steps: Sequence[Step], out: Path) -> Any:
    """The state after all steps; where one fails, what came before it is written."""
    for step in steps:
        try:
            state = step(state)
        except Exception as error:
            _write_before(error, state, out)
            raise
    return state


def _write_before(error: Exception, state: RunState, out: Path) -> None:
    """Write what was computed before an error, if anything, and let the error say so.

    The result of an earlier run is set aside.
    """
    if not isinstance(state, Scheduled) or state.identifiability is None:
        return
    if (out / result_folder.RESULT).is_file():
        own_files.set_aside(out / result_folder.RESULT, "earlier")
    state = state.with_warnings(f"a later part of this run failed: {error}")
    _finish(state, out, report=False, sections=())
    error.add_note(f"What was computed before is in {out / result_folder.RESULT}.")


def _finish(
    state: RunState,
    out: Path,
    *,
    report: bool,
    sections: tuple[str, ...] | None = None,
) -> StudyResult:
    """Check claims, and write result and report. `sections` limits the claims."""
    study_result = assemble_result(state)
    study = state.study
    checked = check_claims(study, msgspec.to_builtins(study_result), sections)
    seconds = round(time.perf_counter() - state.started, 3)
    study_result = msgspec.structs.replace(
        study_result, claims=checked, seconds=seconds
    )
    options = study.report
    study_result = run_files.write(out, study_result, state, sheet=options.pdf)
    if report and (options.html or options.pdf):
        state.progress.stage("report")
        result_folder.write_report(out, html=options.html, pdf=options.pdf)
    return study_result


def assemble_result(state: RunState) -> StudyResult:
    """The result of the steps so far; without claims."""
    machine, setups = state.resolved.machine, state.measurement.setups.values()
    info = describe.with_earlier_sessions(
        describe.machine_info(machine), state.study, state.resolved.measurement
    )
    recorded = state.resolved.dataset is not None
    series = state.readings.series if isinstance(state, Scheduled) else ()
    readings: list[str] = []
    if isinstance(state, Measured):
        readings = digests(series, state.readings.y, state.measurement.setups)
    return msgspec.structs.replace(
        state.result,
        seed=state.seed,
        machine=info,
        readings=counted(state.study, readings),
        setups=[describe.setup_info(machine, setup, series) for setup in setups],
        versions=describe.package_versions(),
        verdicts=accuracy_verdicts(state.result),
        headline=headline.sentences(state.result, recorded, info),
        warnings=list(dict.fromkeys(state.warnings)),
    )
