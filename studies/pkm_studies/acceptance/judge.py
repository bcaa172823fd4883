"""Judges the readings of an acceptance test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec.structs import replace

from oed.accuracy.acceptance import judge, positioning
from oed.base.arrays import Array, Index
from oed.result import (
    AcceptanceSection,
    VerdictRecord,
    VerificationSection,
    verdict,
)
from pkm_studies import csv_table
from pkm_studies.acceptance.plan import AXES, error_columns
from pkm_studies.base import InputError
from pkm_studies.csv_table import CsvTable

#: largest difference of a commanded coordinate from the plan, in its unit
SAME_POSE = 1e-3


def judge_file(section: AcceptanceSection, path: Path) -> VerificationSection:
    """The judgement of a file that was filled in.

    A pose may stand in several rows: its errors are then averaged, and give the
    repeatability. Raises InputError for poses that the plan does not have or that the
    file lacks, and for cells that are no numbers.
    """
    table = csv_table.read(path)
    target = _targets(section, table)
    direction = np.full(len(table), np.nan)
    if "direction" in table.header:
        direction = table.numbers("direction", gaps=True)
    errors, figures = {}, {}
    for name, column in error_columns(section.components).items():
        values = table.numbers(column)
        errors[name] = _by_pose(values, target, len(section.poses))
        unit = section.components[name].unit
        of_component = positioning(values, target, direction, unit)
        if of_component is not None:
            figures[name] = of_component
    components = judge(errors, section.components)
    further = _further(section, table, target)
    every = (*components.values(), *further.values())
    worst = verdict.overall(c.judgement for c in every)
    return VerificationSection(
        passed=worst == "pass",
        verdict=worst,
        readings=len(table),
        components=components,
        positioning=figures,
        further=further,
    )


def _further(
    section: AcceptanceSection, table: CsvTable, target: Index
) -> dict[str, VerdictRecord]:
    """Verdicts on what no drive corrects, as far as it was measured.

    Where further axes were off, the errors that are known in advance are taken off, and
    where they were on, these are added for the error without them.
    """
    taken_back = np.zeros(len(table), dtype=bool)
    if AXES in table.header:
        taken_back = table.numbers(AXES, gaps=True) > 0.0
    verdicts = {}
    for name, column in error_columns(section.further).items():
        if column not in table.header or not any(table.cells(column)):
            continue
        demand = section.further[name]
        known = np.array([offsets[name] for offsets in section.offsets])
        measured = table.numbers(column)
        known_of_rows = known[target]
        with_axes = np.where(taken_back, measured, measured - known_of_rows)
        remaining = _by_pose(with_axes, target, len(known))
        judged = judge({name: remaining}, {name: demand})[name]
        without = float(np.sqrt(np.mean((remaining + known) ** 2)))
        verdicts[name] = replace(judged, without=without)
    return verdicts


def _by_pose(values: Array, target: Index, poses: int) -> Array:
    """Means (poses,) of values (n,) by planned pose."""
    return np.array([values[target == k].mean() for k in range(poses)])


def _targets(section: AcceptanceSection, table: CsvTable) -> Index:
    """Number of the planned pose of each row. Raises InputError."""
    names = list(section.poses[0])
    commanded = np.column_stack([table.numbers(name) for name in names])
    planned = np.array([[pose[n] for n in names] for pose in section.poses])
    distance = np.abs(commanded[:, None] - planned[None]).max(axis=2)
    target = distance.argmin(axis=1)
    for k, nearest in enumerate(distance.min(axis=1)):
        if nearest > SAME_POSE:
            raise table.error(
                k,
                names[0],
                "the acceptance plan has no such pose",
                "measure at the poses of acceptance.csv",
            )
    absent = sorted(set(range(len(planned))) - set(target.tolist()))
    if absent:
        pose = ", ".join(
            f"{n} = {planned[absent[0], i]:.6g}" for i, n in enumerate(names)
        )
        raise InputError(
            f"{len(absent)} planned poses were not measured, the first at {pose}",
            "measure them: the stated power holds for the whole plan",
            file=table.file,
        )
    return np.asarray(target)
