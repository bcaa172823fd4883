"""Readings from CSV files: tables merged, checked and turned into series.

Recorded cable robots are corrected for the stretch that their recorded tensions cause. A
drum pays out the free length L0 of its cable. Under the tension T the cable is

    L = L0 (1 + T / (E A))

long (Pott 2018, Cable-Driven Parallel Robots, section 4.2), so that its joint is in
effect further out by the joint change that is worth L - L0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from oed.base import Array, Index, Mask
from oed.dataset import checks, sessions, table
from oed.dataset.columns import (
    ReadingsColumn,
    column_name,
    is_covariate,
    sigma_units,
    tension_columns,
)
from oed.dataset.data import Dataset, column_layouts
from oed.dataset.file_rows import FILE_COLUMN, short_names
from oed.dataset.readings_file import FILE, ROW, ReadingsError, ReadingsFile
from oed.dataset.table_checks import ORDER_REMEDY
from oed.instrument import Instrument
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.model import Machine

#: most passes, and the change of a joint after which no further one follows, m or rad;
#: each pass lowers the stretch's error by about the strain
MOST_PASSES, SETTLED = 20, 1e-12


def load(path: Path | Sequence[Path], measurement: Measurement) -> Dataset:
    """Load the readings of one file, or of several together.

    Raises ReadingsError for readings that do not fit, OSError for files.
    """
    paths = [path] if isinstance(path, Path) else list(path)
    return load_sessions([paths], measurement)[0]


def load_sessions(
    files: Sequence[Sequence[Path]], measurement: Measurement
) -> tuple[Dataset, tuple[int, ...]]:
    """Load the files of several sessions, the earliest first, as one dataset.

    The second result are the numbers of sessions whose clock starts again. Raises as
    `load` does.
    """
    expected = checks.expected_columns(measurement)
    poses = checks.pose_groups(measurement)
    tables = [[table.read(p, expected, poses) for p in paths] for paths in files]
    joined = sessions.join(tables)
    return from_tables(joined.tables, measurement), joined.restarted


def from_tables(tables: Sequence[ReadingsFile], measurement: Measurement) -> Dataset:
    """Make a dataset of checked tables, for a machine and its set-ups.

    Raises ReadingsError.
    """
    for one in tables:
        checks.check_columns(one, measurement)
    merged = _merge(tables)
    _check_size(merged, measurement)
    checks.check_setups(merged, measurement)
    names = merged.frame["setup"].to_numpy()
    used = [name for name in measurement.setups if (names == name).any()]
    parts = [_setup_readings(merged, measurement, name) for name in used]
    series = tuple(part.series for part in parts if part.series is not None)
    if not series:
        raise ReadingsError(
            "no reading was taken",
            "every reading's cell is empty: fill some",
            file=merged.file,
        )
    covariates = [part.covariates for part in parts]
    return Dataset(
        series=series,
        y=np.concatenate([part.y for part in parts]),
        covariates=pd.concat(covariates, ignore_index=True),
        layouts=column_layouts(measurement, series),
        dropped=sum(part.dropped for part in parts),
        columns=merged.columns,
    )


def _check_size(merged: ReadingsFile, measurement: Measurement) -> None:
    """Refuse more readings than a fit has the memory for."""
    channels = {
        c.name for s in measurement.setups.values() for c in s.instrument.channels
    }
    present = [name for name in channels if name in merged.frame]
    count = int(merged.frame[present].notna().to_numpy().sum())
    if max(count, len(merged.frame)) > table.MOST_READINGS:
        raise table.too_many(max(count, len(merged.frame)), "readings", merged.file)


def _merge(tables: Sequence[ReadingsFile]) -> ReadingsFile:
    """All rows, by order within each run; set-ups and runs as they first appear."""
    frame = pd.concat([one.frame for one in tables], ignore_index=True)
    columns: dict[str, ReadingsColumn] = {}
    for one in reversed(tables):
        columns |= one.columns
    merged = ReadingsFile(tables[0].file, frame, columns)
    repeated = frame.duplicated(["setup", "run", "order"]).to_numpy()
    for k in np.flatnonzero(repeated)[:1]:
        row = frame.iloc[k]
        problem = (
            f"order {row['order']} is used twice in run {row['run']} of {row['setup']}"
        )
        raise merged.error(problem, ORDER_REMEDY, int(k), "order")
    run = frame.groupby(["setup", "run"], sort=False).ngroup().to_numpy()
    rank = np.lexsort([frame["order"].to_numpy(), run])
    sorted_frame = frame.iloc[rank].reset_index(drop=True)
    return dataclasses.replace(merged, frame=sorted_frame)


@dataclasses.dataclass(frozen=True, slots=True)
class _SetupReadings:
    """Readings of one set-up; no series where none was taken."""

    series: Series | None
    y: Array
    covariates: pd.DataFrame
    dropped: int


def _setup_readings(
    merged: ReadingsFile, measurement: Measurement, name: str
) -> _SetupReadings:
    instrument = measurement.setups[name].instrument
    rows = np.flatnonzero((merged.frame["setup"] == name).to_numpy())
    frame = merged.frame.iloc[rows]
    reference = np.zeros(len(rows), dtype=bool)
    if instrument.reference == "run":
        reference = ~frame.duplicated("run").to_numpy()
        _check_runs_have_readings(merged, frame, rows, reference)
    stems = [joint.name for joint in measurement.machine.joints]
    values = _channel_values(frame, instrument, stems)
    taken = np.isfinite(values).all(axis=1) & ~reference
    series = None
    if taken.any():
        used = _with_references(frame["run"], taken, reference)
        series = _series(merged, measurement, name, rows[used])
        sigma = _sigma(frame[taken], instrument)
        series = dataclasses.replace(series, sigma=sigma)
    return _SetupReadings(
        series=series,
        y=values[taken].ravel(),
        covariates=_covariates(frame[taken], merged.frame[FILE]),
        dropped=int((~taken & ~reference).sum()),
    )


def _channel_values(
    frame: pd.DataFrame, instrument: Instrument, joints: Sequence[str]
) -> Array:
    """Readings (n, channels), NaN where not taken.

    Where an instrument implies its reading, an empty cell beside recorded joints has it.
    So has a row of commands without a column, where the file has no joints at all.
    """
    implied = np.full(len(frame), np.nan)
    if instrument.implied is not None:
        implied[_recorded(frame, joints)] = instrument.implied
    columns = []
    for channel in instrument.channels:
        values = implied.copy()
        if channel.name in frame:
            read = frame[channel.name].to_numpy(dtype=float)
            values = np.where(np.isfinite(read), read, implied)
        elif instrument.implied is not None and not set(joints) & set(frame):
            values[:] = instrument.implied
        columns.append(values)
    return np.column_stack(columns)


def _sigma(rows: pd.DataFrame, instrument: Instrument) -> Array | None:
    """Standard deviations (n, channels) of readings, NaN where a row has none."""
    stems = list(sigma_units(instrument.channels))
    if not any(stem in rows and rows[stem].notna().any() for stem in stems):
        return None
    return np.asarray(rows.reindex(columns=stems), dtype=float)


def _recorded(frame: pd.DataFrame, joints: Sequence[str]) -> Mask:
    """Mask (n,) of the rows in which a joint was recorded."""
    present = [stem for stem in joints if stem in frame]
    return np.asarray(frame[present].notna().any(axis=1))


def _check_runs_have_readings(
    merged: ReadingsFile, frame: pd.DataFrame, rows: Index, reference: Mask
) -> None:
    """Refuse runs of one row: it is the reference."""
    size = frame.groupby("run")["run"].transform("size").to_numpy()
    for k in np.flatnonzero(reference & (size == 1))[:1]:
        problem = "this run has a reference and no reading"
        remedy = "add rows measured against it"
        raise merged.error(problem, remedy, int(rows[k]), "run")


def _with_references(run: pd.Series, taken: Mask, reference: Mask) -> Index:
    """Rows with a reading, and the references of runs that have readings."""
    in_use = run.isin(run[taken].unique()).to_numpy()
    return np.flatnonzero(taken | (reference & in_use))


def _covariates(rows: pd.DataFrame, files: pd.Series) -> pd.DataFrame:
    """Covariates of some rows, with the file of each where there are several."""
    columns = ["setup", "run", "order"]
    columns += [c for c in rows.columns if is_covariate(str(c))]
    selected = rows[[*columns, ROW]].rename(columns={ROW: "row"})
    every = list(map(str, files.unique()))
    if len(every) > 1:
        names = dict(zip(every, short_names(every), strict=True))
        of_rows = rows[FILE].astype(str).map(names)
        selected[FILE_COLUMN] = pd.Categorical(of_rows, categories=list(names.values()))
    return selected.reset_index(drop=True)


def _series(
    merged: ReadingsFile, measurement: Measurement, name: str, rows: Index
) -> Series:
    """Poses of rows of the table, from recorded joints, else from commands."""
    machine = measurement.machine
    run = [str(label) for label in merged.frame["run"].iloc[rows]]
    stems = [c.name for c in machine.joints]
    joints = checks.filled_columns(merged, stems, rows)
    tension = _tensions(merged, machine, rows)
    try:
        if joints is None:
            command = _commands(merged, measurement, name, rows)
            series = measurement.series(name, command, run)
        else:
            checks.check_range(merged, machine.joints, joints, rows, "joint range")
            series = measurement.series_from_joints(name, joints, run)
        return with_stretch(measurement, series, tension)
    except AssemblyError as error:
        first = int(np.min(error.indices)) if len(error.indices) else 0
        row = int(rows[min(first, len(rows) - 1)])
        stem = (machine.command if joints is None else machine.joints)[0].name
        problem = f"{machine.name} cannot reach this pose"
        remedy = "check the values and their unit"
        raise merged.error(problem, remedy, row, stem) from error


def _tensions(merged: ReadingsFile, machine: Machine, rows: Index) -> Array:
    """Tensions (n, nq) of the cables in rows of the table, N; NaN where not recorded.

    Raises ReadingsError where a cable's tension is recorded in some rows alone.
    """
    tension = np.full((len(rows), len(machine.joints)), np.nan)
    for k, stem in enumerate(tension_columns(machine)):
        values = checks.filled_columns(merged, [stem], rows)
        if values is not None:
            tension[:, k] = values[:, 0]
    return tension


def _commands(
    merged: ReadingsFile, measurement: Measurement, name: str, rows: Index
) -> Array:
    """Commands (n, n_dof) of rows of the table, within the workspace."""
    machine = measurement.machine
    command = checks.filled_columns(merged, [c.name for c in machine.command], rows)
    if command is None:
        columns = [column_name(c.name, c.unit) for c in machine.command]
        remedy = f"fill {', '.join(columns)}, or the joints"
        raise merged.error("no pose is given", remedy, int(rows[0]), columns[0])
    tool = measurement.setups[name].tool
    outside = sorted({row for row, *_ in machine.out_of_range(command, tool)})
    if outside:
        # a tool beside the axis moves with the platform's turn
        at_reference = measurement.kinematics.at_reference_tool(
            command[outside], np.array(tool)
        )
        place = f"workspace of {machine.name}"
        checks.check_range(merged, machine.command, at_reference, rows[outside], place)
    return command


def with_stretch(measurement: Measurement, series: Series, tension: Array) -> Series:
    """The series with the joints (m, nq) at which cables that do not stretch are as long.

    tension  (n, nq) at the first n poses, N; NaN where it is not recorded. A teach
             pose, which follows them, has that of the first

    Cables without known tension or stiffness E A stay as they are. Lengths are those of
    the nominal machine: their errors count as far as the strain. Raises AssemblyError.
    """
    machine, kinematics = measurement.machine, measurement.kinematics
    if machine.cable_stiffness is None or not len(tension):
        return series
    strain = np.nan_to_num(tension / np.array(machine.cable_stiffness))
    if not strain.any():
        return series
    taught = np.repeat(strain[:1], len(series.q) - len(strain), axis=0)
    strain = np.vstack([strain, taught])
    x, q = series.start, series.q
    for _ in range(MOST_PASSES):
        base, platform, per_length = kinematics.struts(x, q, machine.nominal)
        length = np.linalg.norm(platform - base, axis=-1)
        before, q = q, series.q + per_length * length * strain / (1.0 + strain)
        x = kinematics.forward(q, machine.nominal, x)
        if np.abs(q - before).max() < SETTLED:
            break
    return dataclasses.replace(series, q=q, start=x)
