"""Writes a result and what goes with it into a folder, and reads it back."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

import oed
from oed import dataset
from oed.base import own_files
from oed.measurement.measurement import Measurement, Series
from oed.posterior import posterior
from oed.posterior.checkpoint import Checkpoint
from oed.posterior.posterior import Posterior
from oed.result import StudyResult
from oed.result.verdict import accuracy_verdicts
from pkm_studies.base import files
from pkm_studies.base.errors import InputError
from pkm_studies.resolve import conventions
from pkm_studies.results.stored_result import load_result, read_result, write_report
from pkm_studies.stages.design.section import planned_readings
from pkm_studies.stages.plan import files as plan_files
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.stages.run_state import Fitted, RunState
from pkm_studies.study import Study

__all__ = ["checkpoint", "load_result", "prepare", "rewrite", "write", "write_report"]

#: folder of an unfinished posterior
UNFINISHED = "posterior.unfinished"
RESULT, POSTERIOR = "result.json", "posterior.nc"
#: readings of a second visit, to fill in
VISIT = "second_visit.csv"
#: files that are written after the result
PAGES = ("report.html", "report.pdf", "measurement_sheet.pdf")


def checkpoint(folder: Path, study: Study, seed: int) -> Checkpoint:
    """Where a run with this study and seed saves its unfinished posterior."""
    key = "\n".join([oed.__version__, str(seed), study.text])
    return Checkpoint(folder / UNFINISHED, key)


def prepare(folder: Path) -> None:
    """Make the folder of a result. Raises InputError where that is impossible.

    Also where it has a result.json of another program.
    """
    files.out_folder(folder)
    _written_before(folder)


def write(
    folder: Path, result: StudyResult, state: RunState, *, sheet: bool
) -> StudyResult:
    """Write result.json and, as far as made, posterior, poses and plan.

    `sheet` adds the page to print and fill in at the machine. A file that the user
    changed, as by filling readings into poses.csv, stays, and the new one gets another
    name. Returns the result with the digests of the files. Raises InputError where one
    of the files cannot be written, once the others are.
    """
    known = _written_before(folder)
    written: dict[str, str] = {}
    names: dict[str, str] = {}
    refused: list[OSError] = []
    for name, text in _texts(result, state).items():
        with _collected(refused):
            path = own_files.write_own(folder / name, text.encode(), known)
            written[path.name] = files.digest(text.encode())
            names[name] = path.name
    if isinstance(state, Fitted) and state.posterior is not None:
        with _collected(refused):
            names[POSTERIOR] = _save_posterior(folder, result, state.posterior).name
    warnings = [*result.warnings, *_renamed(names), *_set_aside(folder)]
    warnings += [f"this file was not written: {files.refusal(e)}" for e in refused]
    result = msgspec.structs.replace(result, written=written, warnings=warnings)
    _write_result(folder, result)
    if refused:
        raise files.refusal(refused[0], f"; {RESULT} is written, without this file")
    if sheet:
        _write_sheet(folder, result, state.plan)
    return result


def add_forecast(folder: Path, result: StudyResult, state: RunState) -> StudyResult:
    """Write the files of a forecast beside a result of the folder, which names them."""
    known, written = _written_before(folder), dict(result.written)
    for name, text in state.forecast_files.items():
        path = own_files.write_own(folder / name, text.encode(), known)
        written[path.name] = files.digest(text.encode())
    result = msgspec.structs.replace(result, written=written)
    rewrite(folder, result)
    return result


def rewrite(folder: Path, result: StudyResult) -> None:
    """Write result.json of a folder again, and the reports that the folder has.

    Its verdicts are those of the result as it is now: an acceptance test confirms them.
    """
    result = msgspec.structs.replace(result, verdicts=accuracy_verdicts(result))
    _set_aside(folder)
    _write_result(folder, result)
    html, pdf = ((folder / f"report.{kind}").is_file() for kind in ("html", "pdf"))
    if html or pdf:
        write_report(folder, html=html, pdf=pdf)


def changed_files(folder: Path) -> list[str]:
    """Sentences on reports and sheets that the user changed, and that stay."""
    names = {name: own_files.latest(folder / name).name for name in PAGES}
    return list(_renamed(names))


def _renamed(names: Mapping[str, str]) -> Iterator[str]:
    """Sentences on files that were written under another name."""
    for name, written in names.items():
        if written != name:
            yield (
                f"the file {name} is not as this version wrote it, and stays as it is;"
                f" the new one is {written}"
            )


def _set_aside(folder: Path) -> list[str]:
    """Rename a result.json that is not as it was written; a sentence about it.

    Results of versions that kept no list of their files are among these.
    """
    path = folder / RESULT
    if not path.exists() or own_files.is_own(path):
        return []
    return [
        f"the file {RESULT} was not as this version wrote it, and is now"
        f" {own_files.set_aside(path, 'earlier').name}"
    ]


def _write_result(folder: Path, result: StudyResult) -> None:
    """Write result.json; where its folder refuses it, into a temporary one.

    Raises InputError which says where it is: it may have taken hours.
    """
    encoded = msgspec.json.format(msgspec.json.encode(result), indent=1)
    try:
        own_files.write_own(folder / RESULT, encoded)
    except OSError as error:
        further = "; the result is lost: no temporary folder takes it either"
        with contextlib.suppress(OSError, InputError):
            rescue = Path(tempfile.mkdtemp(prefix="oed-"), RESULT)
            files.write_whole(rescue, encoded)
            further = f"; the result is kept in {rescue}"
        raise files.refusal(error, further) from error


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
        texts["plan.csv"] = plan_files.stages_csv(result.plan)
    if state.plan is not None:
        texts["plan_poses.json"] = plan_files.poses_json(state.plan)
    return texts


def _written_before(folder: Path) -> list[str]:
    """Digests of the files that an earlier run wrote into the folder."""
    path = folder / RESULT
    if not path.exists():
        return []
    try:
        return list(read_result(path).written.values())
    except InputError as error:
        raise InputError(
            "this file is no result, and it is not overwritten",
            "name another folder",
            file=str(path),
        ) from error


def _save_posterior(folder: Path, result: StudyResult, draws: Posterior) -> Path:
    """Write the draws as NetCDF, for xarray and ArviZ."""
    attributes = {"study": result.study, "units": "SI", "seed": str(result.seed)}
    return posterior.save(draws, folder / POSTERIOR, attributes)


def _poses_csv(series: Sequence[Series], measurement: Measurement) -> str:
    """Planned readings as a readings file to fill in."""
    empty = np.full(len(measurement.setup_of_readings(series)), np.nan)
    readings = dataset.from_series(series, empty, measurement)
    return dataset.to_csv(readings, conventions.comments_of(measurement))


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
