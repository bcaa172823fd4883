"""Readings from CSV files: tables merged, checked and turned into series.

Recorded cable robots are corrected for the stretch that their recorded tensions cause. A
drum pays out the free length L0 of its cable. Under the tension T the cable is

    L = L0 (1 + T / (E A))

long (Pott 2018, Cable-Driven Parallel Robots, section 4.2), so that its joint is in
effect further out by the joint change that is worth L - L0.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from oed.base import Array, Index, Mask
from oed.dataset import columns, table
from oed.dataset.columns import (
    REQUIRED,
    SIGMA,
    ReadingsColumn,
    column_meanings,
    column_names,
    sigma_units,
    temperature_body,
    tension_columns,
)
from oed.dataset.data import FILE_COLUMN, Dataset, column_layouts, short_names
from oed.dataset.readings_file import FILE, ROW, ReadingsError, ReadingsFile
from oed.dataset.table import ORDER_REMEDY, cell_remedy
from oed.instrument import Instrument, Setup
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.model import Coordinate, Machine
from oed.text import suggest

# A readings table checked against the machine and its set-ups.
#
# Every check raises ReadingsError for the first problem, with row, column and remedy.

RANGE_SLACK = 1e-9  #: SI amount by which a value may exceed its coordinate's range
MAX_LISTED = 24  #: names that a remedy lists


def expected_columns(measurement: Measurement) -> dict[str, str]:
    """SI unit of every stem that a column may have, temperatures aside."""
    instruments = [s.instrument for s in measurement.setups.values()]
    return columns.expected_columns(measurement.machine, instruments)


def pose_groups(measurement: Measurement) -> list[list[str]]:
    """Stems that only together give a pose: the commands, and the joints."""
    machine = measurement.machine
    return [[c.name for c in machine.command], [c.name for c in machine.joints]]


def check_columns(table: ReadingsFile, measurement: Measurement) -> None:
    """Refuse columns that are unknown, or in a unit of another kind."""
    expected = expected_columns(measurement)
    for stem, column in table.columns.items():
        if stem in REQUIRED:
            continue
        unit = "K" if temperature_body(stem) else expected.get(stem)
        if unit is None:
            names = [ReadingsColumn.of(n, u).name for n, u in expected.items()]
            names.append("temp_<body>_C")
            problem = "unknown column"
            remedy = suggest(column.name, names, "known", MAX_LISTED)
        elif column.unit != unit:
            names = column_names(stem, unit) or [ReadingsColumn.of(stem, unit).name]
            problem, remedy = "the unit does not fit", f"write {', '.join(names)}"
        else:
            continue
        raise ReadingsError(problem, remedy, file=table.file, row=1, column=column.name)


def check_setups(table: ReadingsFile, measurement: Measurement) -> None:
    """Refuse rows of unknown set-ups, and readings that an instrument does not take."""
    setups = measurement.setups
    names = table.frame["setup"]
    for row in np.flatnonzero(~names.isin(setups).to_numpy())[:1]:
        remedy = suggest(names[row], setups, "known", MAX_LISTED)
        raise table.error("no such set-up", remedy, int(row), "setup")
    channels = {c.name for s in setups.values() for c in s.instrument.channels}
    for name, setup in setups.items():
        rows = np.flatnonzero((names == name).to_numpy())
        if rows.size:
            _check_channels(table, setup, rows, channels)


def _check_channels(
    table: ReadingsFile, setup: Setup, rows: Index, channels: set[str]
) -> None:
    """Check the rows of one set-up; `channels` are those of all set-ups."""
    stems = [c.name for c in setup.instrument.channels]
    inner = [name for name in setup.instrument.inner_columns if name in table.columns]
    for stem in stems if inner else []:
        if stem in table.columns:
            problem = f"{inner[0]} is given as well, of which it follows"
            raise table.error(problem, "keep one of the two", int(rows[0]), stem)
    for channel in setup.instrument.channels:
        implied = setup.instrument.implied is not None or bool(inner)
        if channel.name not in table.columns and not implied:
            column = ReadingsColumn.of(channel.name, channel.unit).name
            problem = f"{setup.name} reads {channel.name}, which has no column"
            remedy = f"add {column}, or give the set-up the channels that were read"
            raise table.error(problem, remedy, int(rows[0]), column)
    others = channels - set(stems)
    others |= {f"{SIGMA}{name}" for name in others}
    for other in sorted(others & set(table.columns)):
        values = table.frame[other].to_numpy()[rows]
        for row in rows[np.isfinite(values)][:1]:
            reads = f"{setup.name} ({setup.instrument.name}) reads {', '.join(stems)}"
            remedy = "leave this cell empty, or correct the set-up"
            raise table.error(reads, remedy, int(row), other)


def check_range(
    table: ReadingsFile,
    coordinates: Sequence[Coordinate],
    values: Array,
    rows: Index,
    name: str,
) -> None:
    """Refuse values (n, k) of table rows (n,) outside the range called `name`."""
    for k, coordinate in enumerate(coordinates):
        lower, upper = coordinate.lower, coordinate.upper
        below = values[:, k] < lower - RANGE_SLACK
        above = values[:, k] > upper + RANGE_SLACK
        for i in np.flatnonzero(below | above)[:1]:
            factor = table.columns[coordinate.name].factor
            remedy = (
                f"{coordinate.name} goes from {lower / factor:.6g} to"
                f" {upper / factor:.6g} in this column's unit"
                f"{_other_meaning(table, coordinate, values[:, k])}"
            )
            raise table.error(
                f"outside the {name}", remedy, int(rows[i]), coordinate.name
            )


def _other_meaning(table: ReadingsFile, coordinate: Coordinate, values: Array) -> str:
    """Other meanings of a column, with which all its values are in the range, in words."""
    lower, upper = coordinate.lower - RANGE_SLACK, coordinate.upper + RANGE_SLACK
    name = table.columns[coordinate.name].name
    fitting = [
        phrase.format(name)
        for phrase, meant in column_meanings(coordinate, values).items()
        if ((lower <= meant(values)) & (meant(values) <= upper)).all()
    ]
    return f". All fit if {', or if '.join(fitting[:2])}" if fitting else ""


def filled_columns(
    table: ReadingsFile, stems: Sequence[str], rows: Index
) -> Array | None:
    """Columns (n, k), or None where all are empty. Raises ReadingsError for some."""
    present = [stem for stem in stems if stem in table.columns]
    values: Array = table.frame.loc[rows, present].to_numpy(dtype=float)
    finite = np.isfinite(values)
    if not finite.any():
        return None
    remedy = cell_remedy(stems[0], [stems])
    if len(present) < len(stems):
        absent = next(stem for stem in stems if stem not in present)
        problem = f"there is no column for {absent}"
        raise table.error(problem, remedy, int(rows[0]), absent)
    for i, k in np.argwhere(~finite)[:1]:
        raise table.error("the cell is empty", remedy, int(rows[i]), present[k])
    return values


# Tables of several sessions as those of one: run names of their own, and one clock.
def join(
    sessions: Sequence[Sequence[ReadingsFile]],
) -> tuple[list[ReadingsFile], tuple[int, ...]]:
    """Tables of sessions, the earliest first, as those of one session; numbers of the
    sessions, from 1, whose clock starts again.

    A run whose name an earlier session uses in its set-up gets the number of its session.
    A clock that starts again counts on from the end of the session before.
    """
    joined: list[ReadingsFile] = []
    restarted: list[int] = []
    runs: set[tuple[str, str]] = set()
    end = -np.inf
    for number, tables in enumerate(sessions, start=1):
        start, last = _extent(tables)
        delay = 0.0
        if start <= end:
            delay = end + 1.0 - start
            restarted.append(number)
        renamed = [_renamed_later(one, runs, number, delay) for one in tables]
        runs |= {key for one in renamed for key in _distinct_runs(one.frame)}
        end = max(end, last + delay)
        joined += renamed
    return joined, tuple(restarted)


def _extent(tables: Sequence[ReadingsFile]) -> tuple[float, float]:
    """First and last time of a session, s; (inf, -inf) where none is known."""
    clocks = [one.frame["time"] for one in tables if "time" in one.frame]
    times = np.concatenate([np.empty(0), *clocks])
    finite = times[np.isfinite(times)]
    return float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))


def _distinct_runs(frame: pd.DataFrame) -> set[tuple[str, str]]:
    distinct = frame[["setup", "run"]].drop_duplicates()
    return set(zip(distinct["setup"], distinct["run"], strict=True))


def _renamed_later(
    one: ReadingsFile, runs: set[tuple[str, str]], number: int, delay: float
) -> ReadingsFile:
    """A table of a later session; `runs` are those of earlier ones."""
    frame = one.frame
    if runs & _distinct_runs(frame):
        names = [
            f"{run} (session {number})" if (setup, run) in runs else run
            for setup, run in zip(frame["setup"], frame["run"], strict=True)
        ]
        frame = frame.assign(run=names)
    if "time" in frame:
        frame = frame.assign(time=frame["time"] + delay)
    return dataclasses.replace(one, frame=frame)


#: change of a joint after which no further pass follows, m or rad
JOINT_TOLERANCE = 1e-12


def load(path: Path | Sequence[Path], measurement: Measurement) -> Dataset:
    """Load the readings of one file or several. Raises ReadingsError, OSError."""
    paths = [path] if isinstance(path, Path) else list(path)
    return load_sessions([paths], measurement)[0]


def load_sessions(
    files: Sequence[Sequence[Path]], measurement: Measurement
) -> tuple[Dataset, tuple[int, ...]]:
    """Load the files of several sessions, the earliest first, as one dataset.

    The second result are the numbers of sessions whose clock starts again. Raises as
    `load` does.
    """
    expected = expected_columns(measurement)
    poses = pose_groups(measurement)
    tables = [[table.read(p, expected, poses) for p in paths] for paths in files]
    joined, restarted = join(tables)
    return from_tables(joined, measurement), restarted


def from_rows(
    rows: Sequence[Mapping[str, str]], name: str, measurement: Measurement
) -> Dataset:
    """A dataset of rows, cells by column, numbered as lines. Raises ReadingsError."""
    header = list(dict.fromkeys(column for row in rows for column in row))
    lines: list[tuple[int, list[str]]] = [(1, header)]
    for number, row in enumerate(rows, start=2):
        lines.append((number, [row.get(column, "") for column in header]))
    return from_tables([table.from_rows(lines, name)], measurement)


def from_tables(tables: Sequence[ReadingsFile], measurement: Measurement) -> Dataset:
    """A dataset of checked tables, for a machine. Raises ReadingsError."""
    for one in tables:
        check_columns(one, measurement)
    merged = _merge(tables)
    _check_size(merged, measurement)
    check_setups(merged, measurement)
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
    if max(count, len(merged.frame)) > table.MAX_READINGS:
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
    setup = measurement.setups[name]
    instrument = setup.instrument
    rows = np.flatnonzero((merged.frame["setup"] == name).to_numpy())
    frame = _with_channels(merged.frame.iloc[rows], setup)
    reference = np.zeros(len(rows), dtype=bool)
    if instrument.reference == "run":
        reference = ~frame.duplicated("run").to_numpy()
        _check_runs_have_readings(merged, frame, rows, reference)
    stems = [joint.name for joint in measurement.machine.joints]
    values = _channel_values(frame, instrument, stems)
    taken = np.isfinite(values).all(axis=1) & ~reference
    series = None
    if taken.any():
        used = _add_references(frame["run"], taken, reference)
        series = _series(merged, measurement, name, rows[used])
        sigma = _sigma(frame[taken], instrument)
        series = dataclasses.replace(series, sigma=sigma)
    return _SetupReadings(
        series=series,
        y=values[taken].ravel(),
        covariates=_covariates(frame[taken], merged.frame[FILE]),
        dropped=int((~taken & ~reference).sum()),
    )


def _with_channels(frame: pd.DataFrame, setup: Setup) -> pd.DataFrame:
    """Rows of a set-up with the channels that follow from numbers read inside."""
    instrument = setup.instrument
    if instrument.from_inner is None or not set(instrument.inner_columns) & set(frame):
        return frame
    absent = pd.Series(np.nan, index=frame.index)
    raw = {
        stem: frame.get(stem, absent).to_numpy(dtype=float)
        for stem in instrument.inner_columns
    }
    return frame.assign(**instrument.from_inner(raw, setup.settings))


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


def _add_references(run: pd.Series, taken: Mask, reference: Mask) -> Index:
    """Rows with a reading, and the references of runs that have readings."""
    in_use = run.isin(run[taken].unique()).to_numpy()
    return np.flatnonzero(taken | (reference & in_use))


def _covariates(rows: pd.DataFrame, files: pd.Series) -> pd.DataFrame:
    """Covariates of some rows, with the file of each where there are several."""
    columns = ["setup", "run", "order"]
    columns += [c for c in rows.columns if ReadingsColumn.from_covariate(str(c))]
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
    joints = filled_columns(merged, stems, rows)
    tension = _tensions(merged, machine, rows)
    try:
        if joints is None:
            command = _commands(merged, measurement, name, rows)
            series = measurement.series(name, command, run)
        else:
            check_range(merged, machine.joints, joints, rows, "joint range")
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
    """Tensions (n, nq), N, or NaN; ReadingsError where some rows lack a cable's."""
    tension = np.full((len(rows), len(machine.joints)), np.nan)
    for k, stem in enumerate(tension_columns(machine)):
        values = filled_columns(merged, [stem], rows)
        if values is not None:
            tension[:, k] = values[:, 0]
    return tension


def _commands(
    merged: ReadingsFile, measurement: Measurement, name: str, rows: Index
) -> Array:
    """Commands (n, n_dof) of rows of the table, within the workspace."""
    machine = measurement.machine
    command = filled_columns(merged, [c.name for c in machine.command], rows)
    if command is None:
        columns = [ReadingsColumn.of(c.name, c.unit).name for c in machine.command]
        remedy = f"fill {', '.join(columns)}, or the joints"
        raise merged.error("no pose is given", remedy, int(rows[0]), columns[0])
    tool = measurement.setups[name].tool
    outside = sorted({row for row, *_ in machine.out_of_range(command, tool)})
    if outside:
        # a tool beside the axis moves with the platform's turn
        at_reference = measurement.kinematics.reference_tool_commands(
            command[outside], np.array(tool)
        )
        name_of_range = f"workspace of {machine.name}"
        check_range(merged, machine.command, at_reference, rows[outside], name_of_range)
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
    for _ in range(20):
        base, platform, per_length = kinematics.struts(x, q, machine.nominal)
        length = np.linalg.norm(platform - base, axis=-1)
        before, q = q, series.q + per_length * length * strain / (1.0 + strain)
        x = kinematics.forward(q, machine.nominal, x)
        if np.abs(q - before).max() < JOINT_TOLERANCE:
            break
    return dataclasses.replace(series, q=q, start=x)
