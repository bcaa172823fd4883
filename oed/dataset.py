"""Readings as taken, with the poses they belong to and their covariates, and their CSV.

A file has one row a reading (see `oed.readings_table` for its text): `setup`, `run`,
`order`; the commanded pose, one column a coordinate (`z_mm`), or the recorded joints
(`q1_mm`); covariates; and the instrument's channels (`length_mm`). The first row of a
run is the reference of instruments that compare two poses. An empty reading was not
taken. Everything is checked before it is used, and refused with row, column and remedy.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from oed import readings_table, units
from oed.arrays import Array, Index, Mask
from oed.instrument import Channel, Setup
from oed.kinematics import AssemblyError
from oed.machine import Coordinate, Machine
from oed.measurement import Measurement, Series
from oed.readings_table import ReadingsError, ReadingsFile, suggest

__all__ = [
    "ColumnLayout",
    "Dataset",
    "ReadingsError",
    "from_series",
    "from_tables",
    "load",
    "save",
]

#: covariates with their SI units; temperatures of bodies, `temp_<body>_C`, come on top
COVARIATES = {
    "time": "s",
    "direction": "1",
    "feed": "m/s",
    "payload": "N",
    "repeat": "1",
}
TEMPERATURE = "temp_"
RANGE_SLACK = 1e-9


@dataclasses.dataclass(frozen=True, slots=True)
class ColumnLayout:
    """What the columns of one set-up's readings are."""

    command: tuple[Coordinate, ...]
    joints: tuple[Coordinate, ...]
    channels: tuple[Channel, ...]
    reference: bool  # the first row of a run is its reference


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dataset:
    """Readings in SI.

    series      one for each set-up (as read from files; a plan may have more)
    y           (N,) readings as in `Measurement.readings`: series after series,
                channels innermost
    covariates  one row for each reading of the series, in their order: setup, run,
                order, what the file gave (time, direction, feed, payload, temp_<body>,
                repeat; SI, NaN where unknown), and its row in the file
    layouts     columns of each set-up
    dropped     rows whose reading was not taken
    """

    series: tuple[Series, ...]
    y: Array
    covariates: pd.DataFrame
    layouts: Mapping[str, ColumnLayout]
    dropped: int = 0

    def __post_init__(self) -> None:
        expected = sum(
            len(s) * len(self.layouts[s.setup].channels) for s in self.series
        )
        if self.y.shape != (expected,) or len(self.covariates) != sum(
            len(s) for s in self.series
        ):
            raise ValueError(
                f"{expected} readings are planned, {self.y.shape} and"
                f" {len(self.covariates)} rows given"
            )

    def __len__(self) -> int:
        return len(self.y)

    @property
    def setups(self) -> tuple[str, ...]:
        """Names of the set-ups, in order."""
        return tuple(dict.fromkeys(s.setup for s in self.series))

    @property
    def spans(self) -> tuple[slice, ...]:
        """Where in y each series' readings are."""
        sizes = [len(s) * len(self.layouts[s.setup].channels) for s in self.series]
        return _spans(sizes)

    def take(self, setups: Iterable[str]) -> Dataset:
        """The readings of some set-ups, in this dataset's order. Raises KeyError for a
        set-up without readings.
        """
        wanted = set(setups)
        absent = wanted - set(self.setups)
        if absent:
            raise KeyError(
                f"there are no readings of {sorted(absent)}; there are"
                f" {list(self.setups)}"
            )
        kept = [
            (s, self.y[span])
            for s, span in zip(self.series, self.spans, strict=True)
            if s.setup in wanted
        ]
        return dataclasses.replace(
            self,
            series=tuple(s for s, _ in kept),
            y=np.concatenate([np.empty(0), *[y for _, y in kept]]),
            covariates=self.covariates[
                self.covariates["setup"].isin(wanted)
            ].reset_index(drop=True),
            layouts={s.setup: self.layouts[s.setup] for s, _ in kept},
        )


def _spans(sizes: Sequence[int]) -> tuple[slice, ...]:
    ends = np.cumsum(sizes, dtype=int).tolist()
    return tuple(slice(end - size, end) for size, end in zip(sizes, ends, strict=True))


def load(path: Path | Sequence[Path], measurement: Measurement) -> Dataset:
    """Readings of one file, or of several taken together. Raises ReadingsError."""
    paths = [path] if isinstance(path, Path) else list(path)
    known = _known(measurement)
    return from_tables([readings_table.read(p, known) for p in paths], measurement)


def from_series(
    series: Sequence[Series],
    y: Array,
    measurement: Measurement,
    covariates: pd.DataFrame | None = None,
) -> Dataset:
    """Readings y (N,) of planned series, NaN where not taken; `covariates` has one row
    a reading.

    Order counts within each run; runs of one set-up that come from several series get
    names of their own.
    """
    distinct = _distinct(series)
    frames = [
        pd.DataFrame({"setup": s.setup, "run": s.run.astype(object)}) for s in distinct
    ]
    rows = pd.concat(frames, ignore_index=True)
    layouts = {
        s.setup: column_layout(measurement.machine, measurement.setups[s.setup])
        for s in distinct
    }
    first = np.array([2 if layouts[n].reference else 1 for n in rows["setup"]])
    rows["order"] = (
        rows.groupby(["setup", "run"], sort=False).cumcount().to_numpy() + first
    )
    if covariates is not None:
        rows = rows.join(covariates.reset_index(drop=True))
    return Dataset(
        series=distinct, y=np.asarray(y, dtype=float), covariates=rows, layouts=layouts
    )


def _distinct(series: Sequence[Series]) -> tuple[Series, ...]:
    """Series whose runs do not meet those of an earlier series in the same set-up: the
    later get a number.
    """
    used: set[tuple[str, str]] = set()
    made = []
    for s in series:
        number, run = 1, s.run
        while used & {(s.setup, str(r)) for r in run}:
            number += 1
            run = np.array([f"{r} ({number})" for r in s.run], dtype=np.str_)
        used |= {(s.setup, str(r)) for r in run}
        made.append(dataclasses.replace(s, run=run))
    return tuple(made)


def column_layout(machine: Machine, setup: Setup) -> ColumnLayout:
    """Columns of a set-up's readings on a machine."""
    instrument = setup.instrument
    return ColumnLayout(
        machine.command,
        machine.joints,
        instrument.channels,
        instrument.reference == "run",
    )


# -- from tables -----------------------------------------------------------------------


def from_tables(tables: Sequence[ReadingsFile], measurement: Measurement) -> Dataset:
    """Readings of checked tables, for a machine and its set-ups. Raises ReadingsError."""
    for table in tables:
        _check_columns(table, measurement)
    merged = _merge(tables)
    _check_rows(merged, measurement)
    used = [
        name for name in measurement.setups if (merged.frame["setup"] == name).any()
    ]
    parts = [_one_setup(merged, measurement, name) for name in used]
    series = tuple(p.series for p in parts if p.series is not None)
    if not series:
        raise ReadingsError(
            "no reading was taken",
            "every reading's cell is empty: fill some",
            file=merged.file,
        )
    return Dataset(
        series=series,
        y=np.concatenate([p.y for p in parts]),
        covariates=pd.concat([p.covariates for p in parts], ignore_index=True),
        layouts={
            s.setup: column_layout(measurement.machine, measurement.setups[s.setup])
            for s in series
        },
        dropped=sum(p.dropped for p in parts),
    )


@dataclasses.dataclass(frozen=True, slots=True)
class _DatasetPart:
    """What one set-up has to say; no series where none of its readings was taken."""

    series: Series | None
    y: Array
    covariates: pd.DataFrame
    dropped: int


def _known(measurement: Measurement) -> dict[str, str]:
    """Every stem that a column may have, with its SI unit."""
    machine = measurement.machine
    known = {c.name: c.unit for c in (*machine.command, *machine.joints)}
    known |= {
        c.name: c.unit
        for s in measurement.setups.values()
        for c in s.instrument.channels
    }
    return known | COVARIATES


def _check_columns(table: ReadingsFile, measurement: Measurement) -> None:
    known = _known(measurement)
    for stem, column in table.columns.items():
        if stem in readings_table.REQUIRED:
            continue
        temperature = stem.startswith(TEMPERATURE) and len(stem) > len(TEMPERATURE)
        expected = "K" if temperature else known.get(stem)
        if expected is None:
            names = [_column(n, u) for n, u in known.items()] + ["temp_<body>_C"]
            raise ReadingsError(
                "unknown column",
                suggest(column.name, names),
                file=table.file,
                row=1,
                column=column.name,
            )
        if column.unit != expected:
            written = readings_table.spellings(stem, expected) or [
                _column(stem, expected)
            ]
            problem, remedy = "the unit does not fit", f"write {', '.join(written)}"
            raise ReadingsError(
                problem, remedy, file=table.file, row=1, column=column.name
            )


def _merge(tables: Sequence[ReadingsFile]) -> ReadingsFile:
    """All rows, sorted in time within each run; set-ups and runs stay in the order they
    appear in.
    """
    frame = pd.concat([t.frame for t in tables], ignore_index=True)
    columns = {
        stem: column for t in reversed(tables) for stem, column in t.columns.items()
    }
    merged = ReadingsFile(tables[0].file, frame, columns)
    twice = np.flatnonzero(frame.duplicated(["setup", "run", "order"]).to_numpy())
    if twice.size:
        at = int(twice[0])
        problem = (
            f"order {frame['order'][at]} is used twice in run {frame['run'][at]} of"
            f" {frame['setup'][at]}"
        )
        raise merged.error(
            problem, "count the readings of a run in time: 1, 2, 3", at, "order"
        )
    block = frame.groupby(["setup", "run"], sort=False).ngroup().to_numpy()
    rank = np.lexsort([frame["order"].to_numpy(), block])
    return dataclasses.replace(merged, frame=frame.iloc[rank].reset_index(drop=True))


def _check_rows(table: ReadingsFile, measurement: Measurement) -> None:
    """Every row names a known set-up and reads only what its instrument reads."""
    frame, setups = table.frame, measurement.setups
    for at in np.flatnonzero(~frame["setup"].isin(setups).to_numpy())[:1]:
        raise table.error(
            "no such set-up", suggest(frame["setup"][at], setups), int(at), "setup"
        )
    channels = {c.name for s in setups.values() for c in s.instrument.channels}
    for name, setup in setups.items():
        own = [c.name for c in setup.instrument.channels]
        here = np.flatnonzero((frame["setup"] == name).to_numpy())
        if not here.size:
            continue
        for c in setup.instrument.channels:
            if c.name not in table.columns:
                column = _column(c.name, c.unit)
                raise table.error(
                    f"{name} reads {c.name}, which has no column",
                    f"add {column}",
                    int(here[0]),
                    column,
                )
        for other in (channels - set(own)) & set(table.columns):
            for at in here[np.isfinite(frame[other].to_numpy()[here])][:1]:
                problem = f"{name} ({setup.instrument.name}) reads {', '.join(own)}"
                raise table.error(
                    problem,
                    "leave this cell empty, or correct the set-up",
                    int(at),
                    other,
                )


def _one_setup(
    table: ReadingsFile, measurement: Measurement, name: str
) -> _DatasetPart:
    setup = measurement.setups[name]
    at = np.flatnonzero((table.frame["setup"] == name).to_numpy())
    frame = table.frame.iloc[at]
    first = ~frame.duplicated("run").to_numpy() & (setup.instrument.reference == "run")
    values = frame[[c.name for c in setup.instrument.channels]].to_numpy(dtype=float)
    taken = np.isfinite(values).all(axis=1) & ~first
    alone = np.flatnonzero(
        first & (frame.groupby("run")["run"].transform("size") == 1).to_numpy()
    )
    if alone.size:
        problem = "this run has a reference and no reading"
        raise table.error(
            problem, "add rows measured against it", int(at[alone[0]]), "run"
        )
    kept = _with_reference(list(frame["run"]), taken, first)
    series = _series(table, measurement, name, at[kept]) if taken.any() else None
    return _DatasetPart(
        series,
        values[taken].ravel(),
        _covariates(frame[taken]),
        int((~taken & ~first).sum()),
    )


def _with_reference(run: Sequence[str], taken: Mask, first: Mask) -> Index:
    """Rows to keep: readings taken, and the references of runs that have some."""
    read = {r for r, t in zip(run, taken, strict=True) if t}
    return np.flatnonzero(taken | (first & np.array([r in read for r in run])))


def _covariates(rows: pd.DataFrame) -> pd.DataFrame:
    wanted = ["setup", "run", "order"]
    wanted += [
        c for c in rows.columns if c in COVARIATES or str(c).startswith(TEMPERATURE)
    ]
    return (
        rows[[*wanted, readings_table.ROW]]
        .rename(columns={readings_table.ROW: "row"})
        .reset_index(drop=True)
    )


def _series(
    table: ReadingsFile, measurement: Measurement, name: str, at: Index
) -> Series:
    """The poses of rows `at`, from joints where they were recorded, else from commands."""
    machine = measurement.machine
    frame = table.frame.iloc[at]
    run = [str(r) for r in frame["run"]]
    joints = _filled(table, [c.name for c in machine.joints], at)
    try:
        if joints is not None:
            _in_range(table, machine.joints, joints, at, "joint range")
            return measurement.series_from_joints(name, joints, run)
        command = _filled(table, [c.name for c in machine.command], at)
        if command is None:
            missing = _column(machine.command[0].name, machine.command[0].unit)
            wanted = ", ".join(_column(c.name, c.unit) for c in machine.command)
            raise table.error(
                "no pose is given", f"fill {wanted}, or the joints", int(at[0]), missing
            )
        workspace = machine.workspace(measurement.setups[name].tool)
        _in_range(table, workspace, command, at, f"workspace of {machine.name}")
        return measurement.series(name, command, run)
    except AssemblyError as error:
        k = int(np.min(error.indices)) if len(error.indices) else 0
        stem = (machine.command if joints is None else machine.joints)[0].name
        problem = f"{machine.name} cannot reach this pose"
        raise table.error(
            problem,
            "check the values and their unit",
            int(at[min(k, len(at) - 1)]),
            stem,
        ) from error


def _filled(table: ReadingsFile, stems: Sequence[str], at: Index) -> Array | None:
    """Columns (n, k) of rows `at`; None where none of them is filled. Raises where only
    some are.
    """
    there = [s for s in stems if s in table.columns]
    values: Array = table.frame.loc[at, there].to_numpy(dtype=float)
    if not np.isfinite(values).any():
        return None
    if len(there) < len(stems):
        absent = next(s for s in stems if s not in there)
        raise table.error(
            f"there is no column for {absent}",
            f"give all of {', '.join(stems)}",
            int(at[0]),
            absent,
        )
    for i, k in np.argwhere(~np.isfinite(values))[:1]:
        remedy = f"give all of {', '.join(stems)} in every row of a set-up"
        raise table.error("the cell is empty", remedy, int(at[i]), there[k])
    return values


def _in_range(
    table: ReadingsFile,
    coordinates: Sequence[Coordinate],
    values: Array,
    at: Index,
    what: str,
) -> None:
    for k, c in enumerate(coordinates):
        outside = (values[:, k] < c.lower - RANGE_SLACK) | (
            values[:, k] > c.upper + RANGE_SLACK
        )
        for i in np.flatnonzero(outside)[:1]:
            factor = table.columns[c.name].factor
            remedy = (
                f"{c.name} goes from {c.lower / factor:.6g} to {c.upper / factor:.6g}"
                " in this column's unit"
            )
            raise table.error(f"outside the {what}", remedy, int(at[i]), c.name)


# -- to a file -------------------------------------------------------------------------


def save(path: Path, dataset: Dataset) -> None:
    """Write a readings file that `load` reads back, whole or not at all. Units: mm,
    deg.

    The references of runs come as rows of their own. Raises OSError.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(to_csv(dataset), encoding="utf-8", newline="")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def to_csv(dataset: Dataset) -> str:
    """The text of a readings file; readings that are NaN give empty cells, to be filled
    in.
    """
    rows: list[dict[str, str]] = []
    lengths = _spans([len(s) for s in dataset.series])
    for s, span, here in zip(dataset.series, dataset.spans, lengths, strict=True):
        rows += _rows(
            s, dataset.y[span], dataset.covariates.iloc[here], dataset.layouts[s.setup]
        )
    names = dict.fromkeys(name for row in rows for name in row)
    out = io.StringIO(newline="")
    writer = csv.DictWriter(
        out,
        sorted(names, key=lambda n: _rank(n, dataset)),
        restval="",
        lineterminator="\n",
    )
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _rows(
    series: Series, y: Array, known: pd.DataFrame, layout: ColumnLayout
) -> list[dict[str, str]]:
    values = y.reshape(len(series), -1)
    rows: list[dict[str, str]] = []
    referred: set[str] = set()
    for i, about in enumerate(known.to_dict("records")):
        label = {
            "setup": series.setup,
            "run": str(about["run"]),
            "order": str(int(about["order"])),
        }
        if layout.reference and label["run"] not in referred:
            referred.add(label["run"])
            rows.append(
                label
                | {"order": str(int(about["order"]) - 1)}
                | _pose(series, series.index[i, 1], layout)
            )
        row = label | _pose(series, series.index[i, 0], layout)
        row |= {
            _column(c, _unit_of(c)): _text(about[c], _unit_of(c))
            for c in about
            if _is_covariate(c)
        }
        row |= {
            _column(c.name, c.unit): _text(v, c.unit)
            for c, v in zip(layout.channels, values[i], strict=True)
        }
        rows.append(row)
    return rows


def _pose(series: Series, k: int, layout: ColumnLayout) -> dict[str, str]:
    recorded = bool(np.isnan(series.command[k]).any())
    coordinates, values = (
        (layout.joints, series.q[k])
        if recorded
        else (layout.command, series.command[k])
    )
    return {
        _column(c.name, c.unit): _text(v, c.unit)
        for c, v in zip(coordinates, values, strict=True)
    }


def _rank(name: str, dataset: Dataset) -> tuple[int, int]:
    """Columns in the order of the contract: labels, pose, covariates, readings."""
    layouts = list(dataset.layouts.values())
    groups = [
        list(readings_table.REQUIRED),
        [
            _column(c.name, c.unit)
            for lay in layouts
            for c in (*lay.command, *lay.joints)
        ],
        [
            _column(c, _unit_of(c))
            for c in dataset.covariates.columns
            if _is_covariate(c)
        ],
        [_column(c.name, c.unit) for lay in layouts for c in lay.channels],
    ]
    return next((i, g.index(name)) for i, g in enumerate(groups) if name in g)


def _is_covariate(name: str) -> bool:
    return name in COVARIATES or name.startswith(TEMPERATURE)


def _unit_of(covariate: str) -> str:
    return COVARIATES.get(covariate, "K")


def _column(name: str, unit: str) -> str:
    """How a column is written: `z_mm`, `psi_deg`, `time_s`, `direction`."""
    if name in readings_table.UNITLESS:
        return name
    return f"{name}_{_written(unit)}"


def _written(unit: str) -> str:
    """Unit in which a quantity is written."""
    return {"m": "mm", "rad": "deg", "K": "C", "m/s": readings_table.FEED_UNIT}.get(
        unit, unit
    )


def _text(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return ""
    written = _written(unit)
    factor = (
        units.factor("mm") / units.factor("min")
        if written == readings_table.FEED_UNIT
        else units.factor(written)
    )
    return f"{value / factor:.15g}"
