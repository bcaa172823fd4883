"""Writes what a run ends in into the folder of its result."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import oed
from oed import csv_text, dataset, posterior, result, safe_files
from oed.measurement import Measurement, Series
from oed.posterior import Checkpoint, Posterior
from oed.result import StudyResult
from pkm_studies import describe, files
from pkm_studies.resolve import comments_of
from pkm_studies.result_folder import (
    RESULT,
    VISIT,
    renamed_sentences,
    rewrite,
    set_aside_foreign,
    write_result,
    written_before,
)
from pkm_studies.stages.design.section import planned_readings
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.stages.run_state import Fitted, RunState
from pkm_studies.study import Study

# Files of a plan: stages as CSV, commanded poses with their joints as JSON.

HEADER = [
    "stage",
    "measurement",
    "setups",
    "readings",
    "identifies",
    "cost_min",
    "kappa",
]
#: columns of plans with times
TIMES = ["begin_min", "end_min", "price", "operator"]


def stages_csv(plan: result.PlanSection) -> str:
    """One row a stage, set-ups in working order; with times where the plan has them."""
    has_times = any(stage.begin_min is not None for stage in plan.stages)
    rows: list[list[object]] = [[*HEADER, *(TIMES if has_times else [])]]
    for number, stage in enumerate(plan.stages, start=1):
        times = _times(stage) if has_times else []
        rows.append([number, *_stage_cells(stage), *times])
    return csv_text.of_rows(rows)


def _stage_cells(stage: result.StageRecord) -> list[object]:
    return [
        stage.measurement,
        " ".join(stage.setups),
        stage.readings,
        stage.identifies,
        f"{stage.cost:.1f}",
        f"{stage.kappa:.4g}",
    ]


def _times(stage: result.StageRecord) -> list[object]:
    begin, end = stage.begin_min or 0.0, stage.end_min or 0.0
    return [f"{begin:.1f}", f"{end:.1f}", f"{stage.price:g}", stage.operator]


def poses_json(plan: PlanOutcome) -> str:
    """Commanded poses of each stage in working order, in user units.

    Each pose has the nominal joints and the nominal reading.
    """
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


#: folder of an unfinished posterior
UNFINISHED = "posterior.unfinished"
POSTERIOR = "posterior.nc"


def checkpoint(folder: Path, study: Study, seed: int) -> Checkpoint:
    """Where a run with this study and seed saves its unfinished posterior."""
    key = "\n".join([oed.__version__, str(seed), study.text])
    return Checkpoint(folder / UNFINISHED, key)


def write(
    folder: Path, result: StudyResult, state: RunState, *, sheet: bool
) -> StudyResult:
    """Write result.json and, as far as made, posterior, poses and plan.

    `sheet` adds the page to print and fill in at the machine. A file that the user
    changed, as by filling readings into poses.csv, stays, and the new one gets another
    name. Returns the result with the digests of the files. Raises InputError where one
    of the files cannot be written, once the others are.
    """
    earlier_files = written_before(folder)
    written: dict[str, str] = {}
    names: dict[str, str] = {}
    refused: list[OSError] = []
    for name, text in _texts(result, state).items():
        with _collected(refused):
            path = safe_files.write_own(folder / name, text.encode(), earlier_files)
            written[path.name] = files.digest(text.encode())
            names[name] = path.name
    if isinstance(state, Fitted) and state.posterior is not None:
        with _collected(refused):
            names[POSTERIOR] = _save_posterior(folder, result, state.posterior).name
    warnings = [*result.warnings, *renamed_sentences(names), *set_aside_foreign(folder)]
    warnings += [f"this file was not written: {files.refusal(e)}" for e in refused]
    result = msgspec.structs.replace(result, written=written, warnings=warnings)
    write_result(folder, result)
    if refused:
        raise files.refusal(refused[0], f"; {RESULT} is written, without this file")
    if sheet:
        _write_sheet(folder, result, state.plan)
    return result


def add_forecast(folder: Path, result: StudyResult, state: RunState) -> StudyResult:
    """Write the files of a forecast beside a result of the folder, which names them."""
    earlier_files, written = written_before(folder), dict(result.written)
    for name, text in state.forecast_files.items():
        path = safe_files.write_own(folder / name, text.encode(), earlier_files)
        written[path.name] = files.digest(text.encode())
    result = msgspec.structs.replace(result, written=written)
    rewrite(folder, result)
    return result


@contextlib.contextmanager
def _collected(refused: list[OSError]) -> Iterator[None]:
    """Collect what the disk refuses: the files after it are still to be written."""
    try:
        yield
    except OSError as error:
        refused.append(error)


def _texts(result: StudyResult, state: RunState) -> dict[str, str]:
    """Text files by name that go with the result."""
    texts = {**state.forecast_files, **state.session_files}
    if state.gap_poses is not None:
        texts["gap_poses.csv"] = state.gap_poses
    if state.visit_poses is not None:
        texts[VISIT] = state.visit_poses
    if result.design is not None or state.planned:
        measurement = (
            state.measurement if state.plan is None else state.plan.measurement
        )
        texts["poses.csv"] = _poses_csv(state.planned, measurement)
    if result.plan is not None:
        texts["plan.csv"] = stages_csv(result.plan)
    if state.plan is not None:
        texts["plan_poses.json"] = poses_json(state.plan)
    return texts


def _save_posterior(folder: Path, result: StudyResult, draws: Posterior) -> Path:
    """Write the draws as NetCDF, for xarray and ArviZ."""
    attributes = {"study": result.study, "units": "SI", "seed": str(result.seed)}
    return posterior.save(draws, folder / POSTERIOR, attributes)


def _poses_csv(series: Sequence[Series], measurement: Measurement) -> str:
    """Planned readings as a readings file to fill in."""
    empty = np.full(len(measurement.setup_of_readings(series)), np.nan)
    readings = dataset.from_series(series, empty, measurement)
    return dataset.to_csv(readings, comments_of(measurement))


def _write_sheet(folder: Path, result: StudyResult, plan: PlanOutcome | None) -> None:
    """Write the page for the machine: of a plan of stages, else of a design."""
    poses = result.design.poses if result.design is not None else []
    if plan is not None:
        poses = [
            reading
            for series in plan.scheduled
            for reading in planned_readings(plan.measurement, series)
        ]
    if not poses:
        return
    from pkm_reports import write_sheet

    write_sheet(result, poses, folder)
