"""Runs a study: the only file that knows in which order the steps follow."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

import oed
from oed import dataset, result
from oed.result import StudyResult
from pkm_studies.base import files
from pkm_studies.base.progress import Progress, Silent
from pkm_studies.results import claims
from pkm_studies.stages import describe, headline, result_folder
from pkm_studies.stages.plan.earlier import read_earlier_session
from pkm_studies.stages.run_state import Readings, RunState, start
from pkm_studies.stages.steps.checks import check_readings
from pkm_studies.stages.steps.correct import correct_for_effects
from pkm_studies.stages.steps.design import (
    analyse_identifiability,
    draw_machine,
    plan_stages,
    report_design,
    report_single_stage,
    select_design,
)
from pkm_studies.stages.steps.fit import fit_parameters, sample_posterior
from pkm_studies.stages.steps.gap import diagnose_always, diagnose_gap, preview_gap
from pkm_studies.stages.steps.prediction import predict_accuracy, predict_held_out
from pkm_studies.stages.steps.readings import (
    planned_series,
    simulate_readings,
    take_readings,
)
from pkm_studies.study import Study

Step = Callable[[RunState], RunState]

#: from readings to accuracy
EVALUATION: tuple[Step, ...] = (
    take_readings,
    check_readings,
    analyse_identifiability,
    report_design,
    preview_gap,
    fit_parameters,
    sample_posterior,
    diagnose_gap,
    correct_for_effects,
    predict_accuracy,
    predict_held_out,
    report_single_stage,
    draw_machine,
)
#: everything a study can ask for
STUDY: tuple[Step, ...] = (select_design, plan_stages, *EVALUATION)
#: the same with readings from files: nothing is left to plan
READINGS_GIVEN: tuple[Step, ...] = (select_design, *EVALUATION)
#: the diagnosis alone: neither posterior nor prediction
DIAGNOSIS: tuple[Step, ...] = (
    take_readings,
    check_readings,
    analyse_identifiability,
    fit_parameters,
    diagnose_always,
    correct_for_effects,
    draw_machine,
)
#: sections that the diagnosis alone and the plan alone make: claims about others wait
DIAGNOSIS_SECTIONS = (
    "gap",
    "corrected",
    "estimate",
    "identifiability",
    "identifiability_of",
)
PLAN_SECTIONS = ("plan", "identifiability", "gap_before")


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
    fails.
    """
    state = start(study, seed, progress or Silent(), readings)
    state = state.replace(with_effects=tuple(effects))
    result_folder.prepare(out)
    checkpoint = result_folder.checkpoint(out, study, state.seed)
    steps = READINGS_GIVEN if state.readings_given else STUDY
    state = _follow(steps, state.replace(checkpoint=checkpoint))
    study_result = _finish(state, out, report=report)
    checkpoint.clear()
    return study_result


def diagnose(
    study: Study,
    readings: Sequence[Path] | None,
    out: Path,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Fit readings (the study's own where None), and diagnose what the fit leaves.

    Raises InputError where there are no readings.
    """
    state = start(study, seed, progress or Silent(), readings)
    recorded = state.resolved.dataset is not None
    if not recorded and study.readings is None:
        raise study.place.key("readings").error(
            "there are no readings to diagnose", "give --readings FILE.csv"
        )
    result_folder.prepare(out)
    steps = DIAGNOSIS if recorded else (select_design, plan_stages, *DIAGNOSIS)
    return _finish(_follow(steps, state), out, report=True, sections=DIAGNOSIS_SECTIONS)


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


def planned_state(
    study: Study, after: Path | None, seed: int | None, progress: Progress
) -> RunState:
    """The state of a run with the plan of stages. Raises InputError as `plan` does."""
    state = start(study, seed, progress, [])
    if state.resolved.plan is None:
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
        earlier_result = result_folder.load_result(after)
        earlier = read_earlier_session(state.resolved, after, earlier_result)
        state = state.replace(resolved=earlier.resolved)
    state = plan_stages(state, earlier)
    assert state.plan is not None
    state = state.replace(readings=Readings(series=state.plan.series))
    state = analyse_identifiability(state)
    assert state.identifiability is not None
    state = state.replace(measurement=state.identifiability.measurement)
    state = draw_machine(state)
    cause = state.resolved.gap_design
    if cause is not None and cause.follows_plan:
        state = preview_gap(state)
    return state


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
    assert readings.y is not None
    assert readings.truth is not None
    covariates = readings.covariates
    if covariates is not None:
        covariates = covariates.drop(columns=["setup", "run", "order"])
    data = dataset.from_series(readings.series, readings.y, measurement, covariates)
    files.out_folder(out.parent)
    dataset.save(out, data)
    truth: dict[str, Any] = {
        p.name: {"value": float(value), "unit": p.unit}
        for p, value in zip(measurement.parameters, readings.truth, strict=True)
    }
    if virtual.effects:
        truth["effects"] = virtual.effects
    text = msgspec.json.format(msgspec.json.encode(truth), indent=1)
    return out, files.write_whole(_truth_path(out), text)


def _truth_path(readings: Path) -> Path:
    stem = readings.name.removesuffix(".readings.csv").removesuffix(".csv")
    return readings.with_name(f"{stem}.truth.json")


def _follow(steps: Sequence[Step], state: RunState) -> RunState:
    for step in steps:
        state = step(state)
    return state


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
    checked = claims.check_claims(study, msgspec.to_builtins(study_result), sections)
    seconds = round(time.perf_counter() - state.started, 3)
    study_result = msgspec.structs.replace(
        study_result, claims=checked, seconds=seconds
    )
    options = study.report
    study_result = result_folder.write(out, study_result, state, sheet=options.pdf)
    if report and (options.html or options.pdf):
        state.progress.stage("report")
        result_folder.write_report(out, html=options.html, pdf=options.pdf)
    return study_result


def assemble_result(state: RunState) -> StudyResult:
    """The result of the steps so far; without claims."""
    study, machine = state.study, state.resolved.machine
    setups = state.measurement.setups.values()
    return StudyResult(
        schema=result.SCHEMA,
        version=oed.__version__,
        study=study.name,
        title=study.title or study.name,
        question=study.question,
        seed=state.seed,
        seconds=0.0,
        machine=describe.machine_info(machine),
        setups=[describe.setup_info(machine, setup) for setup in setups],
        study_text=study.text,
        versions=describe.package_versions(),
        headline=headline.sentences(state.sections, state.resolved.dataset is not None),
        warnings=list(dict.fromkeys(state.warnings)),
        **state.sections,
    )
