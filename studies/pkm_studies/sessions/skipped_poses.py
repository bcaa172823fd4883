"""Poses that an operator has skipped, from the remarks of a readings file.

A row without a reading whose remark begins with `skipped` is a pose that the machine could
not be driven to. It is not advised again while the row says so.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from oed.base import Array, Mask
from oed.dataset import ReadingsColumn, SplitText, decode, is_remark
from oed.design import Candidates
from oed.measurement import Measurement, Series
from pkm_studies.base import InputError

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
    return not any(cell.strip() and _stem(name) in read for name, cell in cells.items())


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
    written = {_stem(name): (name, cell) for name, cell in cells.items()}
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


def _stem(name: str) -> str:
    try:
        return ReadingsColumn.parse(name).stem
    except ValueError:
        return name
