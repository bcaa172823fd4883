"""Writes a result and what goes with it into a folder, and reads it back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

import oed
from oed import dataset, posterior
from oed.checkpoint import Checkpoint
from oed.measurement import Measurement, Series
from oed.posterior import Posterior
from oed.result import StudyResult
from pkm_studies import files
from pkm_studies.errors import Place
from pkm_studies.run_state import RunState
from pkm_studies.stages.design.section import planned_readings
from pkm_studies.stages.plan import files as plan_files
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.study import Study

#: folder of an unfinished posterior
UNFINISHED = "posterior.unfinished"
#: bytes of the largest result that is read
LIMIT = 1 << 28


def checkpoint(folder: Path, study: Study, seed: int) -> Checkpoint:
    """Where a run with this study and seed saves its unfinished posterior."""
    key = "\n".join([oed.__version__, str(seed), study.text])
    return Checkpoint(folder / UNFINISHED, key)


def write(folder: Path, result: StudyResult, state: RunState, *, sheet: bool) -> None:
    """Write result.json and, as far as made, posterior, poses and plan.

    `sheet` adds the page to print and fill in at the machine.
    """
    text = msgspec.json.format(msgspec.json.encode(result), indent=1)
    files.write_whole(folder / "result.json", text)
    if state.posterior is not None:
        _save_posterior(folder, result, state.posterior)
    if state.gap_poses is not None:
        files.write_whole(folder / "gap_poses.csv", state.gap_poses)
    if result.design is not None or state.planned:
        poses = _poses_csv(state.planned, state.measurement)
        files.write_whole(folder / "poses.csv", poses)
    if result.plan is not None:
        files.write_whole(folder / "plan.csv", plan_files.stages_csv(result.plan))
    if state.plan is not None:
        poses_json = plan_files.poses_json(state.plan)
        files.write_whole(folder / "plan_poses.json", poses_json)
        if sheet:
            _write_sheet(folder, result, state.plan)


def _save_posterior(folder: Path, result: StudyResult, draws: Posterior) -> None:
    """Write the draws as NetCDF, for xarray and ArviZ."""
    attributes = {"study": result.study, "units": "SI", "seed": str(result.seed)}
    posterior.save(draws, folder / "posterior.nc", attributes)


def _poses_csv(series: Sequence[Series], measurement: Measurement) -> str:
    """Planned readings as a readings file to fill in."""
    empty = np.full(len(measurement.setup_of_readings(series)), np.nan)
    return dataset.to_csv(dataset.from_series(series, empty, measurement))


def _write_sheet(folder: Path, result: StudyResult, plan: PlanOutcome) -> None:
    from pkm_reports import write_sheet

    poses = [
        reading
        for series in plan.scheduled
        for reading in planned_readings(plan.measurement, series)
    ]
    write_sheet(result, poses, folder)


def write_report(
    folder: Path, *, html: bool = True, pdf: bool = True
) -> tuple[Path, ...]:
    """HTML and PDF reports of the result in a folder; their paths."""
    from pkm_reports import write_report

    return write_report(load_result(folder), folder, html=html, pdf=pdf)


def load_result(folder: Path) -> StudyResult:
    """The result in a folder; keys that its file lacks have their defaults.

    Raises InputError where there is none, or the file is no result.
    """
    path = folder / "result.json"
    text = files.read_text(path, limit=LIMIT, what="result")
    try:
        return msgspec.json.decode(text, type=StudyResult)
    except msgspec.DecodeError as error:
        raise Place(str(path)).error(
            f"this is no result: {error}", "make it again with `oed run`"
        ) from error
