"""A result in its folder: the files written, the result read back, the report made from
it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from oed.measurement import Measurement, Series
from oed.result import StudyResult
from pkm_studies import files
from pkm_studies.errors import Place
from pkm_studies.stages.plan import files as plan_files
from pkm_studies.stages.plan.section import PlanOutcome


def write(
    out: Path,
    made: StudyResult,
    planned: Sequence[Series],
    measurement: Measurement,
    stages: PlanOutcome | None,
    *,
    sheet: bool,
) -> None:
    """Write result.json, and what goes with it: planned poses, the plan's stages, its
    sheet (`sheet`).
    """
    text = msgspec.json.format(msgspec.json.encode(made), indent=1)
    files.write_whole(out / "result.json", text)
    if made.design is not None or planned:
        files.write_whole(out / "poses.csv", _poses_csv(planned, measurement))
    if made.plan is not None:
        files.write_whole(out / "plan.csv", plan_files.stages_csv(made.plan))
    if stages is not None:
        told = plan_files.poses_json(stages)
        files.write_whole(out / "plan_poses.json", told)
        if sheet:
            _write_sheet(out, made, told)


def _poses_csv(series: Sequence[Series], measurement: Measurement) -> str:
    """Planned readings as a readings file to fill in: the readings' cells are empty."""
    from oed import dataset

    count = len(measurement.owners(series))
    return dataset.to_csv(
        dataset.from_series(series, np.full(count, np.nan), measurement)
    )


def _write_sheet(out: Path, made: StudyResult, poses: bytes | str) -> None:
    """The page to print and fill in at the machine."""
    from pkm_reports import write_sheet

    stages = msgspec.json.decode(poses)["stages"]
    write_sheet(msgspec.to_builtins(made), [p for s in stages for p in s["poses"]], out)


def write_report(
    folder: Path, *, html: bool = True, pdf: bool = True
) -> tuple[Path, ...]:
    """HTML and PDF from the result in a folder."""
    from pkm_reports import write_report as write

    return write(load_result(folder), folder, html=html, pdf=pdf)


def load_result(folder: Path) -> Mapping[str, Any]:
    """The stored result of a folder as plain data. Raises InputError where there is
    none, or it is no result.
    """
    path = folder / "result.json"
    text = files.read_text(path, limit=1 << 28, what="result")
    try:
        checked = msgspec.json.decode(text, type=StudyResult)
    except msgspec.DecodeError as error:
        raise Place(str(path)).error(
            f"this is no result: {error}", "make it again with `oed run`"
        ) from error
    found: Mapping[str, Any] = msgspec.to_builtins(checked)
    return found
