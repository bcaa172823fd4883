"""Runs a study into a folder: takes the steps, and writes what they gave."""

from __future__ import annotations

import collections
import functools
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

import oed
from oed import csv_text, dataset, posterior, result, safe_files
from oed.dataset import decode, is_counted, reading_digests
from oed.measurement import Measurement, Series
from oed.posterior import Checkpoint, Posterior
from oed.result import StudyResult
from pkm_studies import describe, files, result_folder, sources
from pkm_studies.base import InputError, Progress, Silent
from pkm_studies.resolve import comments_of
from pkm_studies.result_folder import VISIT
from pkm_studies.results import check_claims, load_result
from pkm_studies.stages import order
from pkm_studies.stages.design.section import planned_readings
from pkm_studies.stages.forecast import forecast_errors
from pkm_studies.stages.plan.plan import PlanOutcome
from pkm_studies.stages.plan.task import stored_knowledge
from pkm_studies.stages.readings import planned_series, simulate_readings
from pkm_studies.stages.run_state import Fitted, RunState, Scheduled
from pkm_studies.study import Study

# Files of a plan: stages as CSV, commanded poses with their joints as JSON.


def _stage_row(number: int, stage: result.StageRecord) -> dict[str, object]:
    """A stage in plan.csv, by column; its times where the plan has them."""
    row: dict[str, object] = {
        "stage": number,
        "measurement": stage.measurement,
        "setups": " ".join(stage.setups),
        "readings": stage.readings,
        "identifies": stage.identifies,
        "cost_min": f"{stage.cost:.1f}",
        "kappa": f"{stage.kappa:.4g}",
    }
    if stage.begin_min is None:
        return row
    return row | {
        "begin_min": f"{stage.begin_min:.1f}",
        "end_min": f"{stage.end_min or 0.0:.1f}",
        "price": f"{stage.price:g}",
        "operator": stage.operator,
    }


def poses_json(plan: PlanOutcome) -> str:
    """Poses of each stage in working order, with joints and readings, in user units."""
    stages = []
    records = zip(plan.section.stages, plan.scheduled, strict=True)
    for number, (record, series) in enumerate(records, start=1):
        stages.append(
            {
                "stage": number,
                "measurement": record.measurement,
                "setups": record.setups,
                "begin_min": record.begin_min,
                "end_min": record.end_min,
                "poses": _poses(plan.measurement, series),
            }
        )
    content = msgspec.json.encode({"schema": 1, "stages": stages})
    return msgspec.json.format(content, indent=1).decode()


def _poses(measurement: Measurement, series: Sequence[Series]) -> list[dict[str, Any]]:
    poses = planned_readings(measurement, series)
    joints = [row for s in series for row in s.q[s.index[:, 0]]]
    return [
        msgspec.to_builtins(pose)
        | {"joints": describe.displayed_joints(measurement.machine, row)}
        for pose, row in zip(poses, joints, strict=True)
    ]


# Writes what a run ends in into the folder of its result.

UNFINISHED = "posterior.unfinished"  #: folder of an unfinished posterior
POSTERIOR = "posterior.nc"


def write(
    folder: Path, result: StudyResult, state: RunState, *, sheet: bool
) -> StudyResult:
    """Write result.json and, as far as made, posterior, poses and plan.

    `sheet` adds the page to print and fill in at the machine. Returns the result as
    `result_folder.write` does, and raises as that.
    """
    further = {}
    if isinstance(state, Fitted) and state.posterior is not None:
        save = functools.partial(_save_posterior, result, state.posterior)
        further[POSTERIOR] = save
    texts = {**state.forecast_files, **state.session_files}
    if state.gap_poses is not None:
        texts["gap_poses.csv"] = state.gap_poses
    if state.visit_poses is not None:
        texts[VISIT] = state.visit_poses
    if result.design is not None or state.planned:
        measurement = (
            state.measurement if state.plan is None else state.plan.measurement
        )
        empty = np.full(len(measurement.setup_of_readings(state.planned)), np.nan)
        readings = dataset.from_series(state.planned, empty, measurement)
        texts["poses.csv"] = dataset.to_csv(readings, comments_of(measurement))
    if result.plan is not None:
        rows = [_stage_row(k, s) for k, s in enumerate(result.plan.stages, start=1)]
        texts["plan.csv"] = csv_text.of_tables([*rows[0]], rows)
    if state.plan is not None:
        texts["plan_poses.json"] = poses_json(state.plan)
    result = result_folder.write(folder, result, texts, further)
    if sheet:
        poses = result.design.poses if result.design is not None else []
        if state.plan is not None:
            poses = [
                reading
                for series in state.plan.scheduled
                for reading in planned_readings(state.plan.measurement, series)
            ]
        if poses:
            from pkm_reports import write_sheet

            write_sheet(result, poses, folder)
    return result


def _save_posterior(result: StudyResult, draws: Posterior, path: Path) -> Path:
    """Write the draws as NetCDF, for xarray and ArviZ."""
    attributes = {"study": result.study, "units": "SI", "seed": str(result.seed)}
    return posterior.save(draws, path, attributes)


# Readings files of the sessions that a diagnosis rests on, kept with its result.

#: name of the J-th file of the I-th session in the folder of a result
NAME = "session{}_{}.readings.csv"
PATTERN = re.compile(r"session(\d+)_\d+\.readings\.csv")


def add_sessions(
    state: RunState, readings: Sequence[Path] | None, after: Path | None
) -> RunState:
    """The state of a diagnosis with the texts of its readings files.

    With the folder `after` of an earlier diagnosis, the readings of that and `readings`
    are one dataset. Raises InputError where one of the two is missing.
    """
    latest = list(readings or _files_of(state.study))
    if after is None:
        return state.replace(session_files=_texts([latest]))
    if not latest:
        problem = "there are no readings of a further session"
        remedy = "give --readings FILE.csv"
        raise InputError(problem, remedy, field="--after", value=str(after))
    resolved = state.resolved
    earlier, counted = _stored(after, resolved.machine.name)
    every = resolved.measurement_with(resolved.setups)
    further = resolved.fitted(sources.read_files(latest, every))
    new = reading_digests(further.series, further.y, resolved.setups)
    if is_counted(new, counted):
        raise InputError(
            "these readings are among those of that diagnosis: they would count twice",
            "give the readings of a further session",
            file=", ".join(map(str, latest)),
            field="--after",
            value=str(after),
        )
    sessions = [*earlier, latest]
    data, restarted = sources.read_sessions(sessions, every)
    return state.replace(
        resolved=resolved.with_dataset(data),
        session_files=_texts(sessions),
        readings_given=True,
    ).add_warnings(*_assumptions(restarted))


def _files_of(study: Study) -> list[Path]:
    """Readings files that a study names; none of a virtual machine or a collection."""
    table = study.readings
    if table is None or table.simulate or table.source is not None:
        return []
    return [study.folder / name for name in table.files]


def _stored(folder: Path, machine: str) -> tuple[list[list[Path]], list[str]]:
    """Files of each earlier session, oldest first, and digests of their readings."""
    stored = load_result(folder)
    if stored.machine.name != machine:
        problem = f"that is a result of the machine {stored.machine.name}"
        remedy = f"name one of {machine}"
        raise InputError(problem, remedy, field="--after", value=str(folder))
    sessions: dict[int, list[Path]] = collections.defaultdict(list)
    for name in sorted(stored.written):
        match = PATTERN.fullmatch(name)
        if match:
            sessions[int(match[1])].append(folder / name)
    if not sessions:
        raise InputError(
            "that result keeps no readings files",
            "diagnose its readings with `oed diagnose STUDY --readings FILE.csv --out"
            " DIR` first",
            field="--after",
            value=str(folder),
        )
    return [sessions[number] for number in sorted(sessions)], stored.readings


def _texts(sessions: Sequence[Sequence[Path]]) -> dict[str, str]:
    """Text of each file by its name in the folder of a result."""
    return {
        NAME.format(i, j): decode(path.read_bytes())
        for i, paths in enumerate(sessions, start=1)
        for j, path in enumerate(paths, start=1)
    }


def _assumptions(restarted: Sequence[int]) -> Iterator[str]:
    """What is taken for granted of sessions that are diagnosed together."""
    yield (
        "Sessions are taken together: a set-up of one name in several of them counts as"
        " left mounted. One that was mounted anew needs a name of its own"
    )
    for number in restarted:
        yield (
            f"The clock of session {number} starts again: it counts on from the end of"
            " the session before, so that what warmed up twice is no single course"
        )


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


def run_study(
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
    others = (study.design, study.plan, study.readings)
    is_forecast_alone = study.forecast is not None and others == (None, None, None)
    if is_forecast_alone and not readings:
        return forecast_study(study, out, seed=seed, progress=progress)
    state = RunState.start(study, seed, progress or Silent(), readings)
    state = state.replace(with_effects=tuple(effects))
    result_folder.prepare(out)
    key = "\n".join([oed.__version__, str(state.seed), study.text])
    checkpoint = Checkpoint(out / UNFINISHED, key)
    steps = order.steps_to_readings(state.readings_given)
    state = _take(state.replace(checkpoint=checkpoint), steps, out)
    state = _take(state, order.steps_from_readings(state), out)
    study_result = _finish(state, out, report=report)
    checkpoint.clear()
    return study_result


def diagnose_study(
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
    state = RunState.start(study, seed, progress or Silent(), readings)
    state = add_sessions(state, readings, after)
    recorded = state.resolved.dataset is not None
    if not recorded and study.readings is None:
        raise study.location.key("readings").error(
            "there are no readings to diagnose", "give --readings FILE.csv"
        )
    result_folder.prepare(out)
    state = _take(state, order.steps_of_diagnosis(recorded), out)
    return _finish(state, out, report=True, sections=DIAGNOSIS_SECTIONS)


def plan_study(
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
    state = order.planned(study, after, seed, progress or Silent())
    return _finish(state, out, report=True, sections=PLAN_SECTIONS)


def forecast_study(
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
    state = RunState.start(study, seed, progress or Silent(), [])
    if not (out / result_folder.RESULT).is_file():
        state = forecast_errors(state, None, readings)
        return _finish(state, out, report=True, sections=FORECAST_SECTIONS)
    stored = load_result(out)
    knowledge = stored_knowledge(state.resolved, stored, out)
    state = forecast_errors(state, knowledge, readings)
    result = replace(stored, forecast=state.result.forecast)
    checked = check_claims(study, msgspec.to_builtins(result), FORECAST_SECTIONS)
    names = {claim.claim for claim in checked}
    others = [claim for claim in stored.claims if claim.claim not in names]
    result = replace(result, claims=[*others, *checked])
    return result_folder.add_files(out, result, state.forecast_files)[0]


def simulate_study(
    study: Study, out: Path, *, seed: int | None = None
) -> tuple[Path, Path]:
    """Write readings of the study's virtual machine to `out`, and its truth.

    The truth has the same name with the suffix .truth.json; both paths are returned.
    Raises InputError where one of the files exists.
    """
    for path in (out, _truth_path(out)):
        files.check_new(path)
    state = order.planned_state(study, seed)
    readings = simulate_readings(state, planned_series(state))
    measurement, parameters = state.measurement, readings.truth
    assert parameters is not None  # a virtual machine has some
    covariates = readings.covariates
    if covariates is not None:
        covariates = covariates.drop(columns=["setup", "run", "order"])
    data = dataset.from_series(readings.series, readings.y, measurement, covariates)
    truth: dict[str, Any] = {
        p.name: {"value": float(value), "unit": p.unit}
        for p, value in zip(measurement.parameters, parameters, strict=True)
    }
    if readings.effects:
        truth["effects"] = readings.effects
    text = msgspec.json.format(msgspec.json.encode(truth), indent=1)
    files.write_all({out: dataset.to_csv(data), _truth_path(out): text})
    return out, _truth_path(out)


def _truth_path(readings: Path) -> Path:
    stem = readings.name.removesuffix(".readings.csv").removesuffix(".csv")
    return readings.with_name(f"{stem}.truth.json")


def _take(state: RunState, steps: Sequence[order.Step], out: Path) -> Any:
    """The state after all steps; where one fails, what came before it is written."""
    for step in steps:
        try:
            state = step(state)
        except Exception as error:
            if isinstance(state, Scheduled) and state.identifiability is not None:
                if (out / result_folder.RESULT).is_file():
                    safe_files.set_aside(out / result_folder.RESULT, "earlier")
                state = state.add_warnings(f"a later part of this run failed: {error}")
                _finish(state, out, report=False, sections=())
                error.add_note(
                    f"What was computed before is in {out / result_folder.RESULT}."
                )
            raise
    return state


def _finish(
    state: RunState, out: Path, *, report: bool, sections: tuple[str, ...] | None = None
) -> StudyResult:
    """Check claims, and write result and report. `sections` limits the claims."""
    study_result = order.assemble_result(state)
    study = state.study
    checked = check_claims(study, msgspec.to_builtins(study_result), sections)
    seconds = round(time.perf_counter() - state.started, 3)
    study_result = replace(study_result, claims=checked, seconds=seconds)
    options = study.report
    study_result = write(out, study_result, state, sheet=options.pdf)
    if report and (options.html or options.pdf):
        state.progress.stage("report")
        result_folder.write_report(out, html=options.html, pdf=options.pdf)
    return study_result
