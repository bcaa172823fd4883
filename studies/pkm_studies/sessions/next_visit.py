"""Reads the second visit that a diagnosis advises from its result, in lines."""

from __future__ import annotations

import csv
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from oed import units
from oed.base import Array, Mask
from oed.dataset import ReadingsColumn, SplitText, decode, is_remark
from oed.design import Candidates
from oed.measurement import Measurement, Series
from oed.result import ChosenRun, GapSection, StudyResult
from pkm_studies.base import InputError
from pkm_studies.result_folder import VISIT
from pkm_studies.results import load_result
from pkm_studies.study import Study


def visit_lines(study: Study, named: Path, folder: Path) -> list[str]:
    """What the visit is worth, its runs, and the file to fill in.

    named   the study as the user gave it: its path, or the name of a shipped one
    folder  that of the diagnosis

    Raises InputError where the folder holds no diagnosis of this study.
    """
    result = load_result(folder)
    gap = _diagnosis(study, result, folder)
    visit = gap.second_visit
    if visit is None:
        return [
            "No second visit is advised: the first answer is sure, or no run of those"
            " read so far makes it clearer.",
            *gap.next,
        ]
    table = str(folder / VISIT)
    phrases = ["diagnose", str(named), "--readings", table, "--after", str(folder)]
    return [
        *visit.words,
        "",
        *(
            f"  {run.setup}: {run.run}: {count} poses{_condition(run)}"
            for run, count in zip(visit.runs, visit.poses, strict=True)
        ),
        "",
        f"Fill in {table}, then: oed {shlex.join(phrases)} --out DIR",
    ]


def _diagnosis(study: Study, result: StudyResult, folder: Path) -> GapSection:
    if result.gap is None or result.study != study.name:
        content = "no diagnosis" if result.gap is None else f"study {result.study}"
        raise InputError(
            f"that is not a diagnosis of {study.name}: {content}",
            "name a folder that `oed diagnose` wrote for this study",
            field="--after",
            value=str(folder),
        )
    return result.gap


def _condition(run: ChosenRun) -> str:
    phrase = list(_words(run.condition))
    return f" ({', '.join(phrase)})" if phrase else ""


def _words(condition: Mapping[str, float]) -> Iterator[str]:
    if "direction" in condition:
        yield f"direction {condition['direction']:+.0f}"
    if "feed" in condition:
        yield f"{condition['feed'] / units.MM_PER_MIN:g} mm/min"
    if "payload" in condition:
        yield f"{condition['payload']:g} N"


# Poses that an operator has skipped, from the remarks of a readings file.


#: how the remark of a skipped pose begins
SKIPPED: Final = "skipped"
#: largest difference of a written command, mm or deg: twice its last digit
ROUNDING: Final = 2e-4

#: a set-up, and a command (n_dof,), SI
SkippedPose = tuple[str, Array]


def skipped_in_file(path: Path, measurement: Measurement) -> list[SkippedPose]:
    """Skipped poses of a file; none of one that is no table, as its readings say."""
    try:
        split = SplitText.of(decode(path.read_bytes()))
        lines = [cells for _, cells in split.rows()]
    except (UnicodeDecodeError, csv.Error):
        return []
    header = [name.strip() for name in lines[0]] if lines else []
    rows = (dict(zip(header, cells, strict=False)) for cells in lines[1:])
    return list(skipped_in_rows(rows, measurement))


def skipped_in_rows(
    rows: Iterable[Mapping[str, str]], measurement: Measurement
) -> Iterator[SkippedPose]:
    """Skipped poses of rows, cells by column."""
    for cells in rows:
        pose = _pose(cells, measurement) if is_skipped(cells, measurement) else None
        if pose is not None:
            yield cells["setup"].strip(), pose


def is_skipped(cells: Mapping[str, str], measurement: Measurement) -> bool:
    """Whether a row of a known set-up has no reading, and a remark that says skipped."""
    setup = measurement.setups.get(cells.get("setup", "").strip())
    remarks = [cell for name, cell in cells.items() if is_remark(name)]
    if setup is None or not any(_says_skipped(remark) for remark in remarks):
        return False
    read = {c.name for c in setup.instrument.channels}
    if setup.instrument.implied is not None:
        read |= {joint.name for joint in measurement.machine.joints}
    return not any(
        cell.strip() and ReadingsColumn.stem_of(name) in read
        for name, cell in cells.items()
    )


def allowed(
    pool: Candidates,
    taken: int,
    skipped: Sequence[SkippedPose],
    measurement: Measurement,
) -> Mask:
    """Mask (C,) of the candidates that are read at no skipped pose of their set-up.

    They follow the readings `taken` in the pool. Raises InputError where none is.
    """
    rows = [~_is_at_any(series, skipped, measurement) for series in pool.series]
    mask = np.concatenate(rows)[pool.members[taken:, 0]]
    if not mask.any():
        raise InputError(
            "every candidate is skipped",
            "clear a remark that begins with skipped, or add candidates to the study",
        )
    return np.asarray(mask)


def _is_at_any(
    series: Series, skipped: Iterable[SkippedPose], measurement: Measurement
) -> Mask:
    """Mask (n,) of the readings of a series at a skipped pose."""
    coordinates = measurement.machine.workspace(measurement.setups[series.setup].tool)
    near = ROUNDING * np.array([_factor(c.name, c.unit) for c in coordinates])
    commands = series.reading_commands()
    mask = np.zeros(len(series), dtype=bool)
    for setup, pose in skipped:
        if setup == series.setup:
            mask |= (np.abs(commands - pose) <= near).all(axis=1)
    return mask


def _pose(cells: Mapping[str, str], measurement: Measurement) -> Array | None:
    """The command of a row, SI; None where the row does not have all of it."""
    setup = measurement.setups[cells["setup"].strip()]
    written = {
        ReadingsColumn.stem_of(name): (name, cell) for name, cell in cells.items()
    }
    values = []
    for coordinate in measurement.machine.workspace(setup.tool):
        name, cell = written.get(coordinate.name, ("", ""))
        try:
            number = float(cell.strip().replace(",", "."))
        except ValueError:
            return None
        values.append(number * ReadingsColumn.parse(name).factor)
    return np.array(values)


def _factor(name: str, unit: str) -> float:
    return ReadingsColumn.of(name, unit).factor


def _says_skipped(remark: str) -> bool:
    return remark.strip().casefold().startswith(SKIPPED)
